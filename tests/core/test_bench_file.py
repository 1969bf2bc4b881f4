"""The bench file is strict and reports every problem at once."""

import pytest

from hil.config.bench import BenchConfig
from hil.config.estimator import EstimatorConfig
from hil.config.loading import load_bench
from hil.core.errors import ConfigError

GOOD = """
schema = 1
name = "two sensors"
[imu]
port = "/dev/ttyUSB3"
[encoders]
backend = "emulated"
[safety]
heading_limit_rad = 0.2
"""


@pytest.fixture
def bench(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(GOOD)
    return path


def test_a_good_file_loads_and_can_be_overridden(bench):
    config = load_bench(bench, overrides={"loop.rate_hz": 50.0})
    assert (config.name, config.loop.rate_hz, config.safety.heading_limit_rad) == ("two sensors", 50.0, 0.2)
    assert config.emulated() == ("encoders",)
    assert load_bench(bench, emulate="all").emulated() == ("encoders", "imu")
    assert load_bench(bench, emulate=("imu",)).emulated() == ("encoders", "imu")
    assert load_bench(config) == config
    assert isinstance(config, BenchConfig)


def test_relative_paths_start_at_the_file(bench, tmp_path, monkeypatch):
    bench.write_text(
        GOOD.replace("[imu]", 'calibration = "cal/one.toml"\n[imu]\ncalibration_file = "/etc/imu.toml"')
    )
    monkeypatch.chdir("/")
    config = load_bench(bench, overrides={"encoders.dbc": "mine.dbc"})
    assert config.calibration == str(tmp_path / "cal" / "one.toml")
    assert config.imu.calibration_file == "/etc/imu.toml"
    assert config.encoders.dbc == "/mine.dbc"


def test_every_problem_is_reported_at_once(bench):
    bench.write_text(
        GOOD.replace("schema = 1", "schema = 9")
        + "whim = 3\n[loop]\nrate_hz = -1\n[alignment]\ndrive_sign=[1,1,0,1]\n"
    )
    with pytest.raises(ConfigError) as error:
        load_bench(bench)
    text = str(error.value)
    assert len(error.value.problems) == 4
    for part in ("schema", "safety.whim: unknown key", "loop.rate_hz", "alignment", "found -1"):
        assert part in text


def test_what_was_set_over_the_file_is_distinguished_from_what_it_says(bench):
    bench.write_text(GOOD + "whim = 3\n")
    with pytest.raises(ConfigError) as error:
        load_bench(bench, overrides={"loop.rate_hz": -1, "imu.baud": 115200, "safety": {"fancy": 1}})
    heading = str(error.value).splitlines()[0]
    assert heading.endswith("bench.toml with bench.loop.rate_hz, bench.safety: 2 problem(s)")
    with pytest.raises(ConfigError, match=r"bench\.toml: 1 problem"):
        load_bench(bench, overrides={"imu.baud": 115200})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema = ", "not valid TOML"),
        ("schema = 1\n", "name: missing"),
        (GOOD + "[alignment]\nsteer_zero_rad = [5, 0, 0, 0]\n", r"alignment\.steer_zero_rad\.0: .*radians"),
        (GOOD + "[robot]\nwheel_radius_m = -0.02\n", r"robot\.wheel_radius_m: .*list: \[-0\.02, \.\.\.\]"),
        (GOOD + '[emulation]\nfaults = "imu:off@1"\n', r'emulation\.faults: .*list: \["imu:off@1"\]'),
        (GOOD + "[environment]\nstart_pose = [0, 0]\n", r"environment\.start_pose\.2: .*no number 3"),
        (GOOD + "[environment]\nstart_pose = [0, 0, 0, 0]\n", r"environment\.start_pose: .*4 .* 3 "),
    ],
)
def test_broken_files_are_named(bench, text, message):
    bench.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_bench(bench)


def test_a_byte_order_mark_does_no_harm(bench):
    plain = load_bench(bench)
    bench.write_text("\ufeff" + bench.read_text(encoding="utf-8"), encoding="utf-8")
    assert load_bench(bench) == plain


def test_unknown_sources_devices_and_overrides_are_refused(bench, tmp_path):
    with pytest.raises(ConfigError, match="neither a file nor a shipped profile"):
        load_bench("moonbase")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_bench(tmp_path / "absent.toml")
    with pytest.raises(ConfigError, match="no such device"):
        load_bench(bench, emulate="tracker")
    with pytest.raises(ConfigError, match="is a value"):
        load_bench(bench, overrides={"name.first": 1})


def test_a_profile_speaks_of_the_noise_of_what_it_emulates_only():
    """A real camera beside emulated devices is read with the noise of hardware, unless the file says so."""
    hardware = EstimatorConfig()
    own, mixed = load_bench("emulated"), load_bench("emulated", overrides={"tracker.backend": "real"})
    assert own.estimator.tracker.position_m < 0.5 * hardware.tracker.position_m
    assert mixed.estimator.tracker == hardware.tracker
    assert mixed.estimator.wheels == own.estimator.wheels != hardware.wheels
    given = {"tracker.backend": "real", "estimator.tracker.position_m": 2e-3}
    assert load_bench("emulated", overrides=given).estimator.tracker.position_m == 2e-3
    paper = load_bench("emulated", overrides={"estimator.preset": "paper"})
    assert paper.estimator == EstimatorConfig(preset="paper")


def test_only_bench_files_are_suggested_for_one_that_is_missing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'mine'\n")
    (tmp_path / "bench1.toml").write_text("broken [")
    with pytest.raises(ConfigError) as missing:
        load_bench("bench.toml")
    assert missing.value.remedy == "give a bench.toml or a profile name"
    (tmp_path / "bench_2.toml").write_text('schema = 1\nname = "lab"\n')
    with pytest.raises(ConfigError) as missing:
        load_bench("bench.toml")
    assert missing.value.remedy == "did you mean bench_2.toml?"
    with pytest.raises(ConfigError) as missing:
        load_bench("nope.toml")
    assert "did you mean" not in missing.value.remedy, "the ending alone makes no two names alike"
