"""A bench whose robot is MuJoCo's: the same procedure, the same wires, another physics."""

import json

import numpy as np
import pytest

from hil.bench import open_bench
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import ConfigError
from hil.robot.trajectories import line
from tests.patience import FANLESS

MUJOCO = {"emulation.plant": "mujoco"}


def _climb(overrides):
    with open_bench("emulated", seed=3, overrides={**FANLESS, **overrides}) as bench:
        motion = bench.drive(line((0, 0, 0), (0.04, 0, 0), duration_s=1.6), feedback="ekf")
        return motion, bench.truth()


def test_the_same_drive_in_another_world_ends_where_it_should_and_twice_at_the_same_place():
    pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    motion, truth = _climb(MUJOCO)
    assert abs(truth.pose_body_in_wall[0] - 0.04) < 0.003
    assert not truth.fallen
    again, _ = _climb(MUJOCO)
    np.testing.assert_array_equal(motion.estimate, again.estimate)
    ours, _ = _climb({})
    assert 1e-5 < np.abs(ours.mocap - motion.mocap)[-1, :2].max() < 3e-3


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"emulation.contact": "holding"}, "emulation.contact: 'holding' is of the plant 'mujoco'"),
        ({"emulation.mjcf": "a.xml"}, r"emulation.mjcf: '.*a.xml' is of the plant 'mujoco'"),
        ({**MUJOCO, "emulation.replay": "a.mcap"}, "emulation.plant: 'mujoco' simulates a robot"),
    ],
)
def test_contradictions_are_named(overrides, message):
    with pytest.raises(ConfigError, match=message):
        load_bench("emulated", overrides=overrides)


def test_a_file_of_ones_own_is_found_beside_the_bench_file_and_ends_the_command_when_it_is_no_robot(
    tmp_path, capsys
):
    pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    (tmp_path / "mine.xml").write_text("<mujoco><worldbody/></mujoco>")
    (tmp_path / "bench.toml").write_text(
        'schema = 1\nname = "mine"\n[emulation]\nplant = "mujoco"\nmjcf = "mine.xml"\n'
        '[servos]\nbackend = "emulated"\n[mocap]\nbackend = "emulated"\n'
    )
    code = main(["run", "bring_up", "--bench", str(tmp_path / "bench.toml"), "--out", str(tmp_path / "out")])
    assert code == 2
    said = capsys.readouterr().err
    assert f"emulation.mjcf = {tmp_path / 'mine.xml'}" in said
    assert "joint drive_FL is missing" in said


def test_a_world_that_diverges_ends_a_run_as_an_error(tmp_path, monkeypatch):
    pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    from hil.fakes.plant.mujoco import robot

    sound = robot.mk.is_sound
    monkeypatch.setattr(robot.mk, "is_sound", lambda qpos, qvel: bool(sound(qpos, qvel) and qpos[0] < 0.03))
    monkeypatch.setattr(robot, "compile_for", lambda function, *arguments: None)
    for name in ("prepare", "finish"):  # as plain Python, so that they call it
        monkeypatch.setattr(robot.mk, name, getattr(robot.mk, name).py_func)
    words = ["run", "wall_tracking", "--set", "bench.emulation.plant=mujoco", "--set", 'feedbacks=["ekf"]']
    words += ["--set", "optimal=false", "--set", "length_m=0.06", "--set", "duration_s=3"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 3
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["verdict"] == "ERROR"
    assert "has diverged" in result["error"]["message"]
