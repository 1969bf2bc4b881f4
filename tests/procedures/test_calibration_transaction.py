"""A calibration as a transaction: versions side by side, applied after validation, rolled back, refused."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from made_calibrations import CONFIG, made

from hil.bench import open_bench
from hil.calibration.calibration_file import read_calibration, save_calibration
from hil.calibration.versions import CalibrationVersions
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import ConfigError
from hil.procedure import BenchSource


@pytest.fixture
def versions(tmp_path):
    return CalibrationVersions(tmp_path / "calibration.toml")


def radius(path):
    return read_calibration(path).parameters.r_m[0]


def test_a_new_version_stands_beside_and_changes_nothing_until_it_is_applied(versions):
    for number, r in enumerate((0.0251, 0.0252), start=1):
        kept = versions.add(made(r))
        assert kept.path.name == f"calibration.v{number}.toml"
    assert not versions.path.exists()
    versions.apply(1, CONFIG)
    assert radius(versions.path) == 0.0251
    assert [(v.file.version, v.in_place) for v in versions.versions()] == [(1, True), (2, False)]


@pytest.mark.parametrize("verdict", ["", "FAIL"])
def test_without_a_passed_validation_nothing_is_applied(versions, verdict):
    versions.apply(versions.add(made(0.0251)).file.version)
    before = versions.path.read_bytes()
    versions.add(made(0.0260, verdict))
    with pytest.raises(ConfigError, match="not passed a validation"):
        versions.apply(2)
    assert versions.path.read_bytes() == before


def test_rolling_back_restores_every_byte_and_numbers_are_never_used_again(versions):
    for r in (0.0251, 0.0252, 0.0253):
        versions.apply(versions.add(made(r)).file.version)
    first = versions.versions()[0].path.read_bytes()
    assert versions.rollback().file.version == 2
    assert versions.rollback().file.version == 1
    assert versions.path.read_bytes() == first
    with pytest.raises(ConfigError, match="no earlier version"):
        versions.rollback()
    assert versions.add(made(0.0254)).file.version == 4
    assert versions.rollback(3).file.parameters.r_m[0] == 0.0253
    with pytest.raises(ConfigError, match=r"no version 9.*one of 1, 2, 3, 4"):
        versions.rollback(9)


def test_a_file_that_was_written_by_hand_is_kept_before_another_takes_its_place(versions):
    save_calibration(versions.path, made(0.0250, ""))
    versions.apply(versions.add(made(0.0251)).file.version)
    assert radius(versions.path.with_name("calibration.v1.toml")) == 0.0250
    assert versions.versions()[-1].file.previous["file"] == "calibration.v1.toml"
    assert versions.rollback().file.parameters.r_m[0] == 0.0250


def test_a_calibration_that_is_a_link_stays_one(versions, tmp_path):
    target = tmp_path / "shared.toml"
    versions.path.symlink_to(target)
    save_calibration(versions.path, made(0.0250))
    versions.apply(versions.add(made(0.0251)).file.version)
    assert radius(target) == 0.0251
    versions.rollback()
    assert versions.path.is_symlink()
    assert radius(target) == 0.0250


KILLED = """
import resource, signal, sys
from pathlib import Path
from hil.calibration.calibration_file import keep
signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
keep(Path(sys.argv[1]))
"""
"""Keeps a file; the kernel kills it after the first 100 bytes."""


def test_a_kill_while_a_version_is_kept_leaves_no_half_of_it(versions):
    save_calibration(versions.path, made(0.0250))
    done = subprocess.run([sys.executable, "-c", KILLED, str(versions.path)], check=False, timeout=300)
    assert done.returncode == -signal.SIGXFSZ
    assert [v.in_place for v in versions.versions()] == [True]
    versions.add(made(0.0251))
    assert radius(versions.path.with_name("calibration.v1.toml")) == 0.0250


def test_two_contents_under_one_number_are_named(versions):
    versions.apply(versions.add(made(0.0251)).file.version)
    save_calibration(versions.path, made(0.0252))
    with pytest.raises(ConfigError, match=r"calibration\.v1\.toml.*differs"):
        versions.add(made(0.0253))


OTHER = {
    "wheel radius": ({"robot.wheel_radius_m": [0.0254, 0.0254, 0.0254, 0.026]}, "robot.wheel_radius_m"),
    "wheel position": ({"robot.wheel_x_m": [0.12, -0.12, -0.12, 0.12]}, "robot.wheel_x_m"),
    "servo IDs": ({"servos.steer_ids": [15, 16, 17, 18]}, "servos.steer_ids"),
    "steering zeros": ({"alignment.steer_zero_rad": [0.1, 0.0, 0.0, 0.0]}, "alignment.steer_zero_rad"),
    "servo model": ({"servos.model_number": 1000}, "servos.model_number"),
    "signs": ({"alignment.drive_sign": [1, 1, -1, -1]}, "alignment.drive_sign"),
}


def test_a_calibration_fits_a_bench_that_leaves_the_servo_model_to_the_bus(versions):
    unnamed = load_bench("emulated_floor", overrides={"servos.model_number": None})
    versions.apply(versions.add(made(0.0251)).file.version, unnamed)
    versions.apply(versions.add(made(0.0252, config=unnamed)).file.version, CONFIG)
    assert "servo_model" not in versions.path.read_text()
    assert radius(versions.path) == 0.0252


@pytest.mark.parametrize(("overrides", "words"), OTHER.values(), ids=OTHER.keys())
def test_a_calibration_of_another_robot_is_refused_everywhere(versions, overrides, words):
    other = load_bench("emulated_floor", overrides=overrides)
    kept = versions.add(made())
    for refused in (
        lambda: versions.apply(1, other),
        lambda: versions.rollback(1, other),
        lambda: open_bench(other, calibration=kept.path),
        lambda: BenchSource(other, calibration=kept.path).describe_calibration(),
    ):
        with pytest.raises(ConfigError, match=words) as caught:
            refused()
        assert str(kept.path) in str(caught.value)
    assert not versions.path.exists()


def test_a_calibration_that_failed_is_used_only_where_the_bench_asks_for_it(versions, capsys):
    failed, untried = versions.add(made(0.0257, "FAIL")), versions.add(made(0.0258, ""))
    in_the_file = load_bench("emulated_floor", overrides={"calibration": str(failed.path)})
    for refused in (
        lambda: open_bench(CONFIG, calibration=failed.path),
        lambda: open_bench(in_the_file),
        lambda: BenchSource(CONFIG, calibration=failed.path).describe_calibration(),
    ):
        with pytest.raises(ConfigError, match="failed") as caught:
            refused()
        assert str(failed.path) in str(caught.value)
    command = ["run", "latency", "--bench", "emulated_floor", "--dry-run"]
    assert main([*command, "--calibration", str(failed.path)]) == 2
    assert "failed_calibration = true" in capsys.readouterr().err
    assert main([*command, "--calibration", str(untried.path)]) == 0
    asked = ["--set", "bench.failed_calibration=true", "--calibration", str(failed.path)]
    assert main([*command, *asked]) == 0
    wanted = load_bench("emulated_floor", overrides={"failed_calibration": True})
    with open_bench(wanted, calibration=failed.path) as bench:
        assert bench.geometry.radius_m.tolist() == [0.0257] * 4


def test_a_bench_uses_what_is_in_place(versions):
    versions.apply(versions.add(made(0.0257)).file.version)
    bench = open_bench("emulated_floor", overrides={"calibration": str(versions.path)})
    assert bench.geometry.radius_m.tolist() == [0.0257] * 4
    bench.close()
    source = BenchSource("emulated_floor", calibration=versions.path)
    assert source.describe_calibration()["version"] == 1


@pytest.mark.parametrize("content", ["schema = 1\nversion = 0\n", "\x00"])
def test_a_damaged_version_is_named(versions, content):
    versions.add(made())
    versions.path.with_name("calibration.v2.toml").write_text(content)
    with pytest.raises(ConfigError, match=r"calibration\.v2\.toml"):
        versions.versions()


def run(capsys, *arguments):
    capsys.readouterr()
    code = main(["calibration", *map(str, arguments)])
    return code, capsys.readouterr()


def test_the_commands_list_apply_and_roll_back(versions, capsys, tmp_path):
    save_calibration(tmp_path / "elsewhere" / "result.toml", made(0.0251))
    source = tmp_path / "elsewhere" / "result.toml"
    for _ in range(2):
        code, _ = run(capsys, "apply", versions.path, "--from", source, "--bench", "emulated_floor")
        assert code == 0
    code, said = run(capsys, "list", versions.path, "--json")
    rows = json.loads(said.out)["versions"]
    assert [(r["version"], r["in_place"], r["verdict"]) for r in rows] == [
        (1, False, "PASS"),
        (2, True, "PASS"),
    ]
    assert rows[0]["validation_rmse_m"] == 0.0019
    assert run(capsys, "rollback", versions.path)[0] == 0
    assert read_calibration(versions.path).version == 1
    code, said = run(capsys, "list", versions.path)
    assert said.out.splitlines()[1].startswith("* 1")
    assert run(capsys, "apply", versions.path, "--version", 2)[0] == 0


@pytest.mark.parametrize("verdict", ["", "FAIL"])
def test_a_refused_calibration_from_elsewhere_leaves_nothing_and_is_named_itself(
    versions, capsys, tmp_path, verdict
):
    source = tmp_path / "result.toml"
    save_calibration(source, made(0.0251, verdict))
    before = sorted(tmp_path.rglob("*"))
    code, said = run(capsys, "apply", versions.path, "--from", source)
    assert code == 2
    assert f"{source}: version 1 has not passed a validation run (verdict {verdict or 'none'})" in said.err
    assert sorted(tmp_path.rglob("*")) == before


def test_the_error_that_is_listed_is_of_recordings_that_the_fit_did_not_see(versions, capsys, tmp_path):
    def listed(**mm):
        tables = {name: {"mean": {"rmse_position_m": 1e-3 * value}} for name, value in mm.items()}
        file = tmp_path / f"{len(mm)}.toml"
        save_calibration(file, made(0.0251, validation=tables))
        (row,) = json.loads(run(capsys, "list", file, "--json")[1].out)["versions"]
        return row["validation_rmse_m"]

    of_a_fit = {"nominal": 38.5, "in_sample": 3.4, "leave_one_repetition_out": 4.25}
    assert listed(**of_a_fit) == 0.00425
    assert listed(**of_a_fit, fresh_run=5.0) == 0.005
    assert listed(nominal=38.5, in_sample=3.4) is None


def test_the_commands_refuse_with_exit_code_2(versions, capsys, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(
        'schema = 1\nname = "other"\n[environment]\nsurface = "floor"\ntilt_rad = 0.0\n'
        "[robot]\nwheel_radius_m = [0.03, 0.03, 0.03, 0.03]\n"
    )
    save_calibration(tmp_path / "new.toml", made())
    for arguments, words in (
        (("list", versions.path), "no calibration"),
        (("apply", versions.path), "--version N or --from FILE"),
        (("apply", versions.path, "--from", tmp_path / "nothing.toml"), "cannot be read"),
        (("apply", versions.path, "--from", tmp_path / "new.toml", "--bench", other), "wheel_radius_m"),
        (("rollback", versions.path), "no earlier version"),
    ):
        code, said = run(capsys, *arguments)
        assert code == 2, arguments
        assert words in said.err
    assert not Path(versions.path).exists()
