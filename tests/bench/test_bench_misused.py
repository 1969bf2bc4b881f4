"""Calls and bench files that cannot mean anything are answered by what is wrong and what to write."""

import numpy as np
import pytest

import hil
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, UsageError
from hil.robot.trajectories import circle, line, rotation, scan, through

ORIGIN = (0.0, 0.0, 0.0)


@pytest.fixture
def without_devices(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "none.toml").write_text('schema = 1\nname = "x"\n')


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["doctor", "--json"], "no device in none.toml"),
        (["live"], "no device in none.toml"),
        (["doctor", "--emulate", "imu"], "--emulate imu: the bench has no device at all"),
    ],
)
def test_a_bench_without_any_device_is_not_ok(without_devices, capsys, words, reported):
    assert main([*words, "--bench", "none.toml"]) == 2
    assert reported in capsys.readouterr().err


@pytest.mark.parametrize(
    ("schema", "reported"),
    [
        ("2", "which reads schema 1 (found 2)"),
        ('"1"', "schema: write it without quotes: schema = 1 (found '1')"),
    ],
)
def test_a_bench_file_of_another_schema_names_what_to_do(tmp_path, schema, reported):
    path = tmp_path / "bench.toml"
    path.write_text(f'schema = {schema}\nname = "x"\n[imu]\nport = "/dev/x"\n')
    with pytest.raises(ConfigError) as refused:
        load_bench(path)
    assert reported in str(refused.value)


MAKES = (
    lambda pose: line(pose, (0.3, 0.0, 0.0), duration_s=3.0),
    lambda pose: rotation(pose, 1.0),
    lambda pose: circle(pose, 0.5),
    lambda pose: scan(pose, 1.0, 2, 0.1),
    lambda pose: through([pose, (0.3, 0.0, 0.0)]),
)


@pytest.mark.parametrize("pose", [(0.0, float("nan"), 0.0), None, np.zeros((2, 3)), (0, 0, "x")])
def test_what_is_no_pose_is_refused(pose):
    for make in MAKES:
        with pytest.raises(UsageError, match=r"(?s)start is .*expected a pose: three finite numbers"):
            make(pose)


def test_a_bench_is_used_open_only_and_follows_a_trajectory():
    way = line(ORIGIN, (0.02, 0.0, 0.0), duration_s=1.0)
    bench = hil.open_bench("emulated_floor", faults="tracker:off@4+1")
    assert [fault.device for fault in bench.faults] == ["tracker"]
    for use in (lambda: bench.drive(way), lambda: bench.observe(0.1), bench.settle):
        with pytest.raises(UsageError, match="the bench is not open"):
            use()
    with bench:
        with pytest.raises(UsageError, match="is no trajectory"):
            bench.drive(ORIGIN)
        motion = bench.drive(way, hold_s=0.0, observers="odometry")
        assert motion.observer("odometry").shape == (len(motion.records), 3)
        with pytest.raises(UsageError, match="no observer 'odometri'"):
            motion.observer("odometri")
        with pytest.raises(UsageError, match="no observer 'ekf' ran"):
            bench.observe(0.1).observer("ekf")
    with pytest.raises(UsageError, match="the bench is closed"):
        bench.drive(way)
