"""What the three-dimensional view is made of: a mesh of the user's, forces, and what happens without."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_monitor_sink import needs_rerun, shown

from hil.config.environment import EnvironmentConfig
from hil.config.loading import load_bench
from hil.config.robot import RobotConfig
from hil.core.device import Force
from hil.core.errors import ConfigError
from hil.core.signals import AdhesionSample, Stamp, ThrustSample
from hil.drivers.imu.kind import Imu
from hil.monitor import Scene, scene_state
from hil.monitor.scene_state import Moments
from hil.robot.kinematics import WheelGeometry

TRIANGLE = "v 0 0 0\nv 100 0 0\nv 0 100 50\nf 1 2 3\n"


def bench_with(tmp_path, mesh: str, **more: object):
    return load_bench("emulated", overrides={"monitor.mesh": str(tmp_path / mesh), **more})


@needs_rerun
def test_a_mesh_of_the_users_stands_for_the_body_and_wheels_are_still_drawn(tmp_path):
    from hil.monitor.rerun_stream import RerunStream

    (tmp_path / "robot.obj").write_text(TRIANGLE)
    config = bench_with(tmp_path, "robot.obj", **{"monitor.mesh_unit_m": 0.001})
    stream = RerunStream((str(tmp_path / "run.rrd"),), Scene.of(config, WheelGeometry.nominal()))
    stream.add(shown(0))
    stream.close()
    data = (tmp_path / "run.rrd").read_bytes()
    assert b"estimate/mesh" in data
    assert b"estimate/wheels" in data
    assert b"estimate/body" not in data


def test_a_mesh_that_is_not_there_is_named_and_a_recording_does_without(tmp_path, caplog):
    config = bench_with(tmp_path, "robot.obj")
    with pytest.raises(ConfigError, match=r"monitor\.mesh: .*robot\.obj is no file"):
        Scene.of(config, WheelGeometry.nominal())
    scene = Scene.of(config, WheelGeometry.nominal(), recorded=True)
    assert scene.looks.mesh is None
    assert "robot.obj is not here" in caplog.text


def test_a_relative_mesh_lies_beside_the_bench_file(tmp_path):
    (tmp_path / "my.toml").write_text('schema = 1\nname = "mine"\n[monitor]\nmesh = "robot.glb"\n')
    assert load_bench(tmp_path / "my.toml").monitor.mesh == str(tmp_path / "robot.glb")


def test_forces_that_a_device_reports_replace_the_assumed_ones(monkeypatch):
    reported = Force("fan", np.zeros(3), np.array([0.0, 0.0, -31.0]))

    class Telling(Imu):
        def forces(self, inputs, robot, config):
            yield reported

    follower = Moments(Scene())
    follower.note(shown(0))
    assert [f.name for f in follower.at(shown(0), 0.0).forces] == [
        "fan (assumed)",
        "left propeller (assumed)",
        "right propeller (assumed)",
    ]
    monkeypatch.setattr(scene_state, "kinds", lambda: {"imu": Telling()})
    follower.note(shown(1))
    assert follower.at(shown(1), 0.01).forces == (reported,)


def hanging(fan=None, throttle=None, **tables):
    """Forces of a robot on its wall whose fan and propellers report a speed and a throttle."""
    config = load_bench("emulated", overrides={"robot.thrust_imbalance": 0.2, **tables})
    follower = Moments(Scene.of(config, WheelGeometry.nominal()))
    record = shown(0)
    held = dict.fromkeys(("adhesion", "thrust"), ())
    if fan is not None:
        held["adhesion"] = (AdhesionSample(Stamp(0, 0, 0), fan, 0.5, 1, 1, 22, 30, 30),)
    if throttle is not None:
        held["thrust"] = (ThrustSample(Stamp(0, 0, 0), throttle, math.nan),)
    record = replace(record, inputs=replace(record.inputs, **held))
    follower.note(record)
    return {force.name: force for force in follower.at(record, 0.0).forces}


def test_fan_and_propellers_tell_their_forces_by_speed_and_throttle():
    forces = hanging(
        15_000.0,
        0.5,
        **{"adhesion.rated_force_n": 44.0, "adhesion.rated_rpm": 30_000.0, "thrust.full_force_n": 40.0},
    )
    assert sorted(forces) == ["fan", "left propeller", "right propeller"]
    np.testing.assert_allclose(forces["fan"].force_n, [0, 0, -11.0])
    np.testing.assert_allclose(forces["left propeller"].force_n, [4.0, 0, 0])
    np.testing.assert_allclose(forces["right propeller"].force_n, [6.0, 0, 0])
    assert forces["left propeller"].place_m[1] == -forces["right propeller"].place_m[1] > 0.0


@pytest.mark.parametrize(("fan", "throttle"), [(15_000.0, None), (None, 0.5), (math.nan, 0.5)])
def test_who_reports_nothing_is_still_assumed(fan, throttle):
    names = sorted(hanging(fan, throttle))
    if throttle is None:
        assert names == ["fan", "left propeller (assumed)", "right propeller (assumed)"]
    else:
        assert names == ["fan (assumed)", "left propeller", "right propeller"]


def test_forces_that_fail_are_named_once_and_the_rest_is_shown(monkeypatch, caplog):
    class Failing(Imu):
        package = "hil-evil 6.6"

        def forces(self, inputs, robot, config):
            return 1 / 0

    monkeypatch.setattr(scene_state, "kinds", lambda: {"imu": Failing()})
    follower = Moments(Scene())
    for k in range(3):
        follower.note(shown(k))
    assert caplog.text.count("imu (hil-evil 6.6): forces raised ZeroDivisionError") == 1
    assert len(follower.at(shown(3), 0.0).forces) == 3


@pytest.mark.parametrize(("tilt_rad", "heading_rad"), [(0.0, 0.3), (0.6, 0.3), (np.pi / 2, 0.0)])
def test_loads_by_statics_balance_every_force_and_moment(tilt_rad, heading_rad):
    robot, on_wall = RobotConfig(), EnvironmentConfig(tilt_rad=tilt_rad).on_wall
    loads = robot.wheel_loads_n(tilt_rad, heading_rad, adheres=on_wall)
    x, y, height = robot.centre_of_mass_m
    press, along = robot.weight_n * np.cos(tilt_rad), robot.weight_n * np.sin(tilt_rad)
    fan, thrust = (robot.edf_force_n, robot.thrust_compensation * robot.weight_n) if on_wall else (0.0, 0.0)
    assert np.all(loads > 0.0)
    assert loads.sum() == pytest.approx(press + fan)
    about_y = press * x - height * along * np.cos(heading_rad) + robot.propeller_height_m * thrust
    about_x = press * y + height * along * np.sin(heading_rad)
    assert loads @ np.array(robot.wheel_x_m) == pytest.approx(about_y)
    assert loads @ np.array(robot.wheel_y_m) == pytest.approx(about_x)


def test_without_motion_capture_there_is_no_slip_or_the_truth():
    record = shown(0)
    unseen = replace(record, measurements=replace(record.measurements, mocap=()))
    follower = Moments(Scene())
    follower.note(unseen)
    moment = follower.at(unseen, 0.0)
    assert moment.slip_m_s is None
    assert moment.truth is None
