"""A robot on a wall is on no floor: what the IMU says of gravity is held against environment.tilt_rad."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import hil
from hil.bench.cross_checks.gravity import gravity_checks
from hil.bench.doctor.examination import examine
from hil.bench.hold.held_state import held_in_words
from hil.bench.hold.tilt_check import TiltWatch, tilt_rad
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, UsageError
from hil.core.signals import Status
from hil.robot.trajectories import line

HOP = line((0, 0, 0), (0.06, 0, 0), duration_s=2.0)


def turned(degrees, axis):
    """The true mount of an emulated IMU, turned about an axis of the body; the bench file has it straight."""
    half = math.radians(degrees) / 2.0
    mount = [math.cos(half), 0.0, 0.0, 0.0]
    mount[1 + "xyz".index(axis)] = math.sin(half)
    return {"emulation.imu": {"mount_rotation_wxyz": mount}}


STANDS_UP = turned(90.0, "y")
"""Level, its gravity is that of a robot on a wall."""


def says(up, *, count=10, status=Status.OK, t_ns=0):
    """Samples of a robot at rest whose up axis is this one."""
    stamp = [SimpleNamespace(t_ns=t_ns + 10_000_000 * k) for k in range(count)]
    up_m_s2 = 9.81 * np.array(up) / np.linalg.norm(up)
    return [SimpleNamespace(stamp=s, status=status, gravity_m_s2=up_m_s2) for s in stamp]


def steep(degrees):
    return (math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees)))


@pytest.mark.parametrize("degrees", [17.0, 90.0, 180.0])
def test_the_tilt_is_that_of_gravity_in_the_body(degrees):
    floor = load_bench("emulated_floor")
    assert math.degrees(tilt_rad(floor, says(steep(degrees)))) == pytest.approx(degrees, abs=1e-6)
    upright = load_bench(
        "emulated_floor", overrides={"imu.mount_rotation_wxyz": [0.5**0.5, 0, -(0.5**0.5), 0]}
    )
    assert math.degrees(tilt_rad(upright, says((1.0, 0.0, 0.0)))) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("scale", [0.5, math.nan])
def test_what_is_no_gravity_says_nothing(scale):
    samples = [SimpleNamespace(gravity_m_s2=scale * 9.81 * np.array((1.0, 0.0, 0.0)))]
    assert math.isnan(tilt_rad(load_bench("emulated_floor"), samples))


@pytest.mark.parametrize(
    ("profile", "degrees", "steeper", "refused"),
    [
        ("emulated_floor", 20.0, False, False),
        ("emulated_floor", 30.0, True, True),
        ("emulated", 70.0, False, False),
        ("emulated", 0.0, False, True),
        ("emulated", 120.0, True, True),
    ],
)
def test_only_a_wide_difference_counts(profile, degrees, steeper, refused):
    watch = TiltWatch(load_bench(profile))
    watch.saw(says(steep(degrees)))
    assert bool(watch.steeper()) is steeper
    if refused:
        with pytest.raises(ConfigError, match=rf"environment\.tilt_rad: .*tilted by {degrees:.0f} deg"):
            watch.must_agree()
    else:
        watch.must_agree()


@pytest.mark.parametrize(
    "samples",
    [
        says(steep(90.0), count=9),
        says(steep(90.0), status=Status.FROZEN),
        says(steep(90.0), t_ns=0)[:5] + says(steep(90.0), count=5, t_ns=5_000_000_000),
    ],
    ids=["few", "bad", "old"],
)
def test_few_bad_or_old_samples_say_nothing(samples):
    watch = TiltWatch(load_bench("emulated_floor"))
    watch.saw(samples)
    assert (watch.known, watch.steeper()) == (False, "")
    watch.must_agree()


def test_an_imu_of_another_world_or_without_servos_says_nothing_of_the_robot(monkeypatch):
    floor = load_bench("emulated_floor")
    alone = floor.model_copy(update={"servos": None})
    for config, others in ((floor, ("imu",)), (alone, ())):
        monkeypatch.setattr(BenchConfig, "elsewhere", lambda self, others=others: others)
        watch = TiltWatch(config)
        watch.saw(says(steep(90.0)))
        assert (watch.known, watch.steeper()) == (True, "")
        assert not list(gravity_checks(config, {"imu": says(steep(90.0))}))


@pytest.mark.parametrize(
    ("profile", "degrees", "state"),
    [
        ("emulated", 60.0, "contradicted"),
        ("emulated", 80.0, "unconfirmed"),
        ("emulated", 130.0, "contradicted"),
        ("emulated_floor", 30.0, "contradicted"),
        ("emulated_floor", 14.0, "contradicted"),
        ("emulated_floor", 7.0, "unconfirmed"),
    ],
)
def test_a_floor_for_a_wall_and_a_wall_for_a_floor_are_contradicted(profile, degrees, state):
    (check,) = gravity_checks(load_bench(profile), {"imu": says(steep(degrees))})
    assert (check.key, check.state) == ("environment.tilt_rad", state)
    assert math.degrees(check.says) == pytest.approx(degrees)


def test_nothing_moves_and_the_floor_is_not_believed():
    with hil.open_bench("emulated_floor", overrides=STANDS_UP) as bench:
        with pytest.raises(ConfigError, match="tilted by 90 deg, bench file says 0; nothing is moved"):
            bench.drive(HOP)
        with pytest.raises(UsageError, match=r"torque is not released: .*tilted by 90 deg"):
            bench.release()
    assert bench.held.state == "NOT HELD"
    assert bench.held.lost
    assert "tilted by 90 deg, bench file says 0" in held_in_words(bench.held.to_json())
    assert np.hypot(*bench.truth().pose_body_in_wall[:2]) < 1e-3


def test_a_drive_that_begins_unseen_is_ended_at_once():
    with hil.open_bench("emulated_floor", overrides=STANDS_UP) as bench:
        with pytest.raises(ConfigError, match="nothing is moved"):
            bench.drive(HOP, start_pose=(0.0, 0.0, 0.0))
        assert np.hypot(*bench.truth().pose_body_in_wall[:2]) < 2e-3


def test_an_exit_that_releases_does_not_where_the_imu_shows_a_wall():
    kept = {}
    for name, mount in (("level", {}), ("wall", STANDS_UP)):
        with hil.open_bench("emulated_floor", overrides={"exit.policy": "release", **mount}) as bench:
            bench.observe(0.3)
            bench.devices.servos.enable()
            bench.on_close(lambda bench=bench, name=name: kept.__setitem__(name, bench.held.why))
    assert "torque was released" in kept["level"]
    assert "torque was released" not in kept["wall"]


@pytest.mark.parametrize("moment", ["never moved", "looked at"])
def test_a_look_at_a_robot_without_torque_waits_for_the_imu(moment):
    with hil.open_bench("emulated_floor", overrides=STANDS_UP) as bench:
        if moment == "looked at":
            assert bench.look().state == "NOT HELD"
    assert bench.held.state == "NOT HELD"
    assert not bench.held.lost, "it has not been set in motion"


def test_on_the_floor_a_robot_drives_by_its_wheels_with_an_imu_that_is_a_little_turned():
    with hil.open_bench("emulated_floor", overrides=turned(15.0, "x")) as bench:
        with pytest.raises(ConfigError, match=r"imu\.mount_rotation_wxyz"):
            bench.drive(HOP)
        bench.drive(HOP, feedback="odometry")
    assert bench.held.state == "not needed"


@pytest.mark.parametrize(
    ("fault", "mount", "state"),
    [("garbage@1", {}, "not needed"), *((fault, STANDS_UP, "NOT HELD") for fault in ("stuck@1", "off@1"))],
)
def test_a_broken_imu_does_not_undo_what_it_had_shown(fault, mount, state):
    with hil.open_bench("emulated_floor", overrides=mount, faults=[f"imu:{fault}"]) as bench:
        bench.observe(0.8)
        bench.devices.servos.enable()
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 500_000_000)
    assert bench.held.state == state


def test_the_doctor_says_how_steep_the_robot_stands():
    others = {"tracker": None, "mocap": None, "encoders": None}
    on_a_wall = hil.open_bench("emulated_floor", overrides={**others, **STANDS_UP})
    (finding,) = [f for f in examine(on_a_wall, watch_s=0.5) if f.check == "tilt_rad"]
    assert (finding.device, finding.level) == ("environment", "failure")
    assert "tilted by 90 deg, bench file says 0" in finding.found


@pytest.mark.parametrize(("without", "by"), [((), "IMU"), (("imu",), "")])
def test_only_an_imu_that_is_there_confirms_the_floor(without, by):
    with hil.open_bench("emulated_floor", overrides=dict.fromkeys(without)) as bench:
        bench.devices.servos.enable()
    assert bench.held.state == "not needed"
    assert (bench.held.by, bench.held.confirmed) == (by, bool(by))


def test_what_is_no_gravity_measures_no_tilt():
    watch = TiltWatch(load_bench("emulated_floor"))
    for sample in says((0.0, 0.0, 1.0)):
        watch.saw([SimpleNamespace(**vars(sample) | {"gravity_m_s2": 0.5 * sample.gravity_m_s2})])
    assert watch.known
    assert not watch.measured
