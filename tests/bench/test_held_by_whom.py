"""HELD takes a trusted sensor that sees a slide; its way is reported by sensors that saw where it stopped."""

import math
from contextlib import suppress

import numpy as np
import pytest

import hil
from hil.bench.hold.motion_since_stop import JOINTS, MotionSinceStop
from hil.core.device import DeviceKind
from hil.core.errors import SafetyStop
from hil.core.signals import SERVOS, ImuSample
from hil.drivers.mocap.kind import KIND as MOCAP_KIND
from hil.drivers.servos.kind import KIND as SERVO_KIND
from hil.drivers.tracker.kind import KIND as CAMERA_KIND
from hil.robot.trajectories import line

CLIMB = line((0, 0, 0), (0.4, 0, 0), duration_s=8.0)
HOP = line((0, 0, 0), (0.12, 0, 0), duration_s=2.4)
FAR_M = 0.005
VESCS = {"thrust.model": "vesc"}
TETHER = {"safety.tethered": True}
BRIEFLY = {"exit.look_after_s": 1.0}
"""For a robot that is not found held, however long the check lasts."""


def left(*faults, without=(), seed=5, feedback="ekf", way=CLIMB, **overrides):
    """Drive until something ends it; the last word, the stop, the true way since it (m) and speed (m/s)."""
    bench = hil.open_bench("emulated", seed=seed, faults=faults, overrides=dict.fromkeys(without) | overrides)
    stop = None
    with bench:
        try:
            bench.drive(way, start_pose=np.zeros(3), feedback=feedback, hold_s=0.5)
        except SafetyStop as found:
            stop = found
        stopped = bench.truth().pose_body_in_wall.copy()
    there = bench.truth().pose_body_in_wall.copy()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 300_000_000)
    later = bench.truth().pose_body_in_wall.copy()
    return bench.held, stop, math.dist(there[:2], stopped[:2]), math.dist(later[:2], there[:2]) / 0.3


def test_on_a_tether_no_sensor_has_to_see_a_slide_and_the_word_says_so():
    blind = ("tracker", "mocap", "adhesion", "load_cells", "thrust")
    said = "; on its tether, so no sensor has to see whether it slides"
    with hil.open_bench("emulated", seed=1, overrides=dict.fromkeys(blind) | TETHER) as bench:
        bench.devices.actuators().enable()
    assert bench.held.state == "HELD"
    assert said in bench.held.why
    with hil.open_bench("emulated", seed=1, overrides=TETHER) as bench:
        bench.devices.actuators().enable()
    assert bench.held.state == "HELD"
    assert said not in bench.held.why


@pytest.mark.parametrize(
    ("more", "without", "state"),
    [((), (), "HELD"), ((), ("mocap",), "NOT HELD"), (("mocap:stuck@1.5",), (), "NOT HELD")],
)
def test_a_camera_that_drifts_at_rest_is_outvoted_by_motion_capture_that_lives(more, without, state):
    drift = "tracker:wrong@1.0,drift_y_m_s=-0.005"
    held, _, moved_m, speed_m_s = left(drift, *more, without=without, way=HOP)
    assert moved_m < 1e-3
    assert speed_m_s < 1e-4
    assert held.state == state
    assert state == "NOT HELD" or held.moved_m < 1e-3


@pytest.mark.parametrize(("still", "moved_m"), [(0.001, 0.007), (0.008, None)])
def test_a_way_within_the_noise_of_a_coarse_sensor_is_none(still, moved_m):
    class Coarse(DeviceKind):
        motion_threshold, measures_position = still, True

    travel = MotionSinceStop({"rangefinder": Coarse()}, radius_m=0.025)
    travel.saw("rangefinder", 0, np.zeros(1))
    for t_ns in range(1, 6):
        travel.saw("rangefinder", t_ns, np.full(1, 0.007))
    assert travel.moved_m(["rangefinder"], slides=True) == pytest.approx(moved_m)
    for t_ns in range(6, 11):
        travel.saw("rangefinder", t_ns, np.full(1, 0.02))
    assert travel.moved_m(["rangefinder"], slides=True) == pytest.approx(0.02)


@pytest.mark.parametrize("plant", ["own", pytest.param("mujoco", marks=pytest.mark.long)])
def test_a_camera_that_was_just_in_doubt_does_not_witness_that_the_robot_rests(plant):
    held, stop, _, speed_m_s = left(
        "plant:adhesion_loss@2.8,factor=0.25",
        "tracker:wrong@2.5,scale=0",
        without=("mocap", "load_cells"),
        **{"emulation.plant": plant, **BRIEFLY},
    )
    assert stop.reason == "sensors_disagree"
    assert speed_m_s > 0.1, "it slides or falls"
    assert held.state == "NOT HELD"
    assert held.moved_m is None, "no trusted sensor saw it"


def test_motion_capture_does_without_the_camera():
    held, stop, _, speed_m_s = left("tracker:wrong@2.5,scale=0.3", without=("load_cells",))
    assert stop.reason == "sensors_disagree"
    assert held.state == "HELD"
    assert "camera" not in held.why.split(";")[0]
    assert (held.moved_m is None, speed_m_s < 1e-4) == (False, True)


@pytest.mark.long
def test_load_cells_do_without_a_camera_where_the_propellers_report_or_are_not_needed():
    """They feel what presses; that a part of the weight is not carried any more they do not feel."""
    blind, lie = ("mocap",), "tracker:wrong@2.5,scale=0.3"
    held, _, _, speed_m_s = left(lie, without=blind)
    assert (held.state, speed_m_s < 1e-4) == ("NOT HELD", True)
    assert "without the propellers: they report nothing, and no sensor sees whether it slides" in held.why
    for overrides in (VESCS, {"environment.friction": 0.9}):
        held, stop, _, speed_m_s = left(lie, without=blind, **overrides)
        assert stop.reason == "sensors_disagree"
        assert (held.state, held.moved_m, speed_m_s < 1e-4) == ("HELD", None, True)


def test_propellers_that_weaken_unseen_are_not_called_held():
    blind = ("mocap", "tracker")
    held, _, _, speed_m_s = left(
        "thrust:wrong@3.2,factor=0.55", without=blind, seed=1, feedback="odometry", way=HOP
    )
    assert speed_m_s > 0.005, "it slides while the load cells feel all of the fan"
    assert held.state == "NOT HELD"


def test_propellers_that_have_fallen_silent_are_not_called_held_while_the_robot_still_stands():
    """They go on until their timeout, and the robot with them; then it falls."""
    bench = hil.open_bench("emulated", seed=1, faults=["thrust:bus_off@3.0"], overrides=VESCS)
    said = []
    with bench:
        with suppress(SafetyStop):
            bench.drive(HOP, start_pose=np.zeros(3), hold_s=0.3)
        while not bench.truth().fallen:
            said.append(bench.look(0.4))
            bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000_000)
    assert len(said) > 2
    assert {held.state for held in said} == {"NOT HELD"}
    assert "without the propellers: their controllers are silent and may have let go" in said[0].why


@pytest.mark.parametrize(
    ("doubted", "held"),
    [
        ({"tracker": False, "mocap": False, "servos": False}, True),
        ({"tracker": True}, True),
        ({"tracker": True, "mocap": False}, False),
    ],
)
def test_of_two_that_contradict_each_other_one_is_right_and_both_see_it_rest(doubted, held):
    with hil.open_bench("emulated", seed=1) as bench:
        bench._hold.stopped(doubted)
        found = bench.look()
    assert (found.state == "HELD") is held
    assert ("camera" in found.why.split(";")[0]) is (held and doubted != {"tracker": True})


@pytest.mark.long
def test_a_camera_is_believed_again_only_after_a_way_on_which_others_agree():
    faults = ("tracker:wrong@1.3+1.5,scale=0",)
    bench = hil.open_bench("emulated", seed=5, faults=faults, overrides={"mocap": None, "load_cells": None})
    with bench:
        with pytest.raises(SafetyStop, match="sensors_disagree"):
            bench.drive(CLIMB, start_pose=np.zeros(3))
        assert bench.look().state == "NOT HELD"
        bench.observe(2.0)
        doubted = bench.look()
        assert doubted.state == "NOT HELD", "at rest a frozen camera is not recognised"
        assert "what the camera said before the stop is in doubt" in doubted.why
        bench.drive(line((0, 0, 0), (0.15, 0, 0), duration_s=3.0), start_pose=np.zeros(3), hold_s=0.5)
        assert bench.look().state == "HELD"


def test_servos_alone_do_not_confirm_it_where_there_are_others_who_should():
    """On a tether it cannot fall; that it stands still another sensor has to see, if the bench has one."""
    others, settings = ("imu", "tracker", "mocap"), TETHER | {"exit.look_after_s": 1.0}
    faults = [f"{name}:off@0.5" for name in others]
    with hil.open_bench("emulated", seed=1, faults=faults, overrides=settings) as bench:
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_000_000_000)
        held = bench.look(0.6)
    assert held.state == "NOT HELD"
    assert "no camera, motion capture or IMU confirms that it stands still" in held.why
    alone = dict.fromkeys((*others, "encoders", "load_cells"))
    with hil.open_bench("emulated", seed=1, overrides=alone | settings) as bench:
        held = bench.look(0.6)
    assert held.state == "HELD"
    assert "at rest by servo positions" in held.why


def test_wheels_and_imu_alone_do_not_see_a_slide():
    """A seal that leaks does not show in the fan's speed; the robot slides, servos and gravity rest."""
    blind = {"without": ("mocap", "tracker", "load_cells"), "feedback": "odometry", "way": HOP}
    held, *_ = left("plant:adhesion_loss@3.1,factor=0.42", **blind, **BRIEFLY)
    assert held.state == "NOT HELD"
    held, _, moved_m, _ = left(**blind, **BRIEFLY)
    assert (held.state, held.moved_m) == ("NOT HELD", None)
    assert "that takes a camera, motion capture or load cells" in held.why
    assert moved_m < FAR_M
    held, *_ = left(**blind, **TETHER)
    assert held.state == "HELD", "a tether holds it"


@pytest.mark.parametrize(
    ("faults", "without"),
    [
        (["servos:brownout@3+1"], ("mocap", "tracker")),
        pytest.param(["servos:brownout@3+1", "tracker:off@3+0.8"], ("mocap",), marks=pytest.mark.long),
        pytest.param(["servos:brownout@3+1", "tracker:stuck@3"], ("mocap",), marks=pytest.mark.long),
    ],
)
def test_a_way_that_no_sensor_saw_is_not_reported_as_nothing(faults, without):
    held, _, moved_m, _ = left(
        *faults, without=without, feedback="odometry" if "tracker" in without else "ekf", **TETHER
    )
    assert moved_m > 0.01, "it slid while the servos had no torque"
    assert (held.state, held.moved_m) == ("HELD", None)
    assert "how far it has moved since the stop was not measured" in held.why


def test_a_robot_without_load_cells_is_held_by_all_others():
    held, *_ = left("load_cells:off@1.5", way=HOP)
    for who in ("servo positions", "IMU", "camera", "motion capture", "N by the fan's speed"):
        assert who in held.why
    assert held.state == "HELD"
    assert "nothing by the load cells" in held.why


def test_the_accelerometer_sees_a_robot_that_speeds_up(monkeypatch):
    """What it feels differs from its weight by more than a data sheet allows."""
    felt = property(lambda sample: np.array([7.0, 0.0, 0.0]))
    monkeypatch.setattr(ImuSample, "specific_force_m_s2", felt)
    held, *_ = left(way=HOP, **BRIEFLY)
    assert held.state == "NOT HELD"
    assert "speeding up" in held.why


def test_a_driver_that_raises_what_it_may_not_leaves_the_looking_to_the_others(monkeypatch, caplog):
    bench = hil.open_bench("emulated", seed=5)
    with bench:
        bench.drive(line((0, 0, 0), (0.02, 0, 0), duration_s=1.0), start_pose=np.zeros(3), hold_s=0.1)
        monkeypatch.setattr(bench.devices.get("tracker"), "read", lambda: 1 / 0)
    assert bench.held.state == "HELD"
    assert "camera" not in bench.held.why
    assert "tracker: its driver failed" in caplog.text


def travel():
    return MotionSinceStop({JOINTS: SERVO_KIND, "tracker": CAMERA_KIND}, 0.05)


def test_the_way_counts_from_where_it_was_stopped():
    seen = travel()
    seen.passed("tracker", 1_000_000_000, np.array([1.0, 0.0, 0.0]))
    seen.stopped(1_010_000_000)
    for k in range(5):
        seen.saw("tracker", 1_020_000_000 + k, np.array([1.0, 0.02, 0.0]))
    assert seen.moved_m({"tracker"}, slides=True) == pytest.approx(0.02)
    assert seen.moved_m({JOINTS}, slides=True) is None
    seen.begins_anew("tracker")
    seen.saw("tracker", 1_100_000_000, np.array([7.0, 0.0, 0.0]))
    assert seen.moved_m({"tracker"}, slides=True) is None, "its frame is another"


def test_wheels_tell_the_way_where_nothing_slides():
    seen = travel()
    seen.passed(JOINTS, 1_000_000_000, np.zeros(8))
    seen.stopped(1_000_000_000)
    for k in range(5):
        seen.saw(JOINTS, 1_020_000_000 + k, np.array([0.1] * 4 + [0.0] * 4))
    assert seen.moved_m({JOINTS}, slides=False) == pytest.approx(0.005)
    assert seen.moved_m({JOINTS}, slides=True) is None
    assert seen.moved_m(set(), slides=False) is None


@pytest.mark.parametrize(
    ("camera_m", "mocap_m", "moved_m"),
    [(0.002, 0.003, 0.003), (0.015, 0.016, 0.02), (0.0, 0.012, 0.02), (0.04, 0.041, 0.041)],
)
def test_wheels_against_two_who_agree_do_not_count(camera_m, mocap_m, moved_m):
    """In the second case the difference is small, in the third the two do not agree."""
    seen = MotionSinceStop({JOINTS: SERVO_KIND, "tracker": CAMERA_KIND, "mocap": MOCAP_KIND}, 0.05)
    ways = {JOINTS: np.array([0.4] * 4 + [0.0] * 4), "tracker": [camera_m, 0, 0], "mocap": [mocap_m, 0, 0]}
    for name, way in ways.items():
        seen.passed(name, 1_000_000_000, np.zeros(len(way)))
    seen.stopped(1_000_000_000)
    for name, way in ways.items():
        for k in range(5):
            seen.saw(name, 1_020_000_000 + k, np.array(way))
    assert seen.moved_m(ways, slides=True) == pytest.approx(moved_m)
    assert seen.moved_m({JOINTS, "tracker"}, slides=True) == pytest.approx(max(camera_m, 0.02))


def test_servos_with_old_data_do_not_say_how_far_it_has_moved():
    """The wheels seem to turn for 0.3 s after the stop, and are named."""
    held, stop, moved_m, _ = left("servos:delayed@2,delay_s=0.3", seed=8137)
    assert stop.reason == "servo_jump"
    assert held.state == "HELD"
    assert "the servos show" in held.why
    assert held.moved_m == pytest.approx(moved_m, abs=0.003)


def test_a_witness_that_did_not_see_the_stop_says_nothing_of_the_way():
    seen = travel()
    seen.passed("tracker", 1_000_000_000, np.zeros(3))
    seen.stopped(1_200_000_000)
    seen.saw("tracker", 1_300_000_000, np.array([0.5, 0.0, 0.0]))
    assert seen.moved_m({"tracker"}, slides=True) is None
    fresh = travel()
    fresh.saw("tracker", 1_300_000_000, np.array([0.5, 0.0, 0.0]))
    assert fresh.moved_m({"tracker"}, slides=True) == 0.0, "nothing was stopped: its way begins here"


@pytest.mark.parametrize(
    ("servo_id", "bench_values"),
    [pytest.param(1, {}, marks=pytest.mark.long), (8, {"servos.prefetch": True})],
)
def test_a_servo_that_answers_late_for_ever_is_held_with_the_others_and_named(servo_id, bench_values):
    held, stop, moved_m, speed_m_s = left(f"servo.{servo_id}:slow@2.5,answer_s=0.02", **bench_values)
    assert stop.reason == "stale_servos"
    assert held.state == "HELD"
    assert f"(ID {servo_id}: answers after 2" in held.why
    assert moved_m < FAR_M
    assert speed_m_s < 1e-4


def test_a_servo_that_answers_every_other_read_is_named_and_held():
    """It is seen at rest with torque often enough; the observation goes on while it is silent."""
    way = line((0, 0, 0), (0.04, 0, 0), duration_s=1.2)
    fault = "servo.drive_FL:intermittent@1,period_s=0.02,duty=0.5"
    held, stop, moved_m, speed_m_s = left(fault, seed=8151, way=way)
    assert stop is None
    assert held.state == "HELD"
    assert "drive_FL did not answer" in held.why
    assert not any(name in held.why for name in SERVOS[1:])
    assert moved_m < FAR_M
    assert speed_m_s < 1e-4


@pytest.mark.parametrize("plant", ["own", pytest.param("mujoco", marks=pytest.mark.long)])
@pytest.mark.parametrize("fault", [pytest.param("thrust:off@2.1", marks=pytest.mark.long), "thrust:off@2.3"])
def test_propellers_that_fail_as_the_way_ends_are_not_called_holding(fault, plant):
    """They report nothing, and push for a moment longer: the look outlasts that."""
    way = line((0, 0, 0), (0.04, 0, 0), duration_s=1.2)
    held, stop, _, _ = left(fault, seed=1, way=way, **{"emulation.plant": plant})
    assert stop is None
    assert held.state == "NOT HELD"


def test_propellers_that_weaken_as_the_way_ends_are_made_up_for_by_the_fan():
    """The robot slides while it is checked: what can still press, presses."""
    way = line((0, 0, 0), (0.04, 0, 0), duration_s=1.2)
    held, stop, moved_m, speed_m_s = left("thrust:wrong@2.2,factor=0.5", seed=1, way=way)
    assert stop is None
    assert held.state == "HELD"
    assert moved_m < 0.04
    assert speed_m_s < 1e-4
