"""A frame of places that moves is no way of the robot, and not where the next drive begins."""

import numpy as np
import pytest

import hil
from hil.bench.hold.frame_jumps import FrameJumps
from hil.core.clock import nanoseconds
from hil.core.errors import SafetyStop
from hil.robot.trajectories import line
from tests.patience import FANLESS

FAR = np.array([0.12, 0.0, 0.0])


def reported(leaps, name, *places, dt_s=0.01, begin_s=0.0, estimated=None):
    """Names whose frame has moved, by a row of samples."""
    found = []
    for k, x_m in enumerate(places):
        at = None if estimated is None else np.array([estimated[k], 0.0])
        found += leaps.follow(name, nanoseconds(begin_s + k * dt_s), np.array([x_m, 0.0]), at)
    return found


def test_a_robot_that_drives_stops_and_falls_makes_no_leap():
    t_s = np.arange(0.0, 1.0, 0.01)
    driven = np.where(t_s < 0.3, 0.12 * t_s, 0.036)
    fallen = 0.5 * 9.81 * np.maximum(t_s - 0.4, 0.0) ** 2
    noise = np.random.default_rng(1).normal(0.0, 5e-4, len(t_s))
    leaps = FrameJumps()
    assert reported(leaps, "mocap", *(driven + fallen + noise)) == []
    assert leaps.size_m("mocap") == 0.0


def test_a_leap_is_reported_once_and_a_wild_sample_leaves_nothing():
    leaps = FrameJumps()
    assert reported(leaps, "mocap", 0.0, 0.0, 0.02, 0.02, 0.02) == ["mocap"]
    assert leaps.size_m("mocap") == pytest.approx(0.02)
    assert reported(leaps, "mocap", 0.02, 0.3, 0.02, 0.02, begin_s=0.1) == ["mocap", "mocap"]
    assert leaps.size_m("mocap") == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("gone_m", "estimated_m", "leapt"), [(0.05, 0.05, 0), (0.03, 0.05, 1), (0.0, 0.0, 0)]
)
def test_behind_a_gap_of_a_drive_it_is_held_against_the_estimate(gone_m, estimated_m, leapt):
    leaps = FrameJumps()
    found = reported(leaps, "mocap", 0.0, gone_m, dt_s=1.0, estimated=(0.0, estimated_m))
    assert found == ["mocap"] * leapt
    assert leaps.size_m("mocap") == pytest.approx(abs(gone_m - estimated_m) if leapt else 0.0)


@pytest.mark.parametrize(
    ("mocap_m", "tracker_m", "who"), [(0.1, 0.001, "mocap"), (0.0, 0.1, "tracker"), (0.1, 0.1, None)]
)
def test_without_other_samples_a_sensor_that_alone_went_away_has_jumped(mocap_m, tracker_m, who):
    leaps = FrameJumps()
    found = []
    for t_s, far in ((0.0, 0.0), (60.0, 1.0)):
        for name, way_m in (("tracker", tracker_m), ("mocap", mocap_m)):
            found += reported(leaps, name, far * way_m, begin_s=t_s)
    assert found == ([who] if who else [])


def drive(bench, number):
    """The n-th of several drives; how far off its estimate ends (m), and three of its sigmas."""
    last = []
    bench.drive(
        line(number * FAR, (number + 1) * FAR, duration_s=3.0),
        hold_s=0.5,
        on_cycle=lambda record: last.append(record),
    )
    record = last[-1]
    off = np.abs(record.state.pose_body_in_wall - bench.truth().pose_body_in_wall)[:2]
    return off, 3.0 * np.sqrt(np.diag(record.state.covariance)[:2])


@pytest.mark.parametrize(
    ("profile", "faults"),
    [
        ("emulated", ["mocap:wrong@5.0,offset_m=0.1"]),
        pytest.param("emulated_floor", ["mocap:wrong@3.37,offset_m=0.1"], marks=pytest.mark.long),
        pytest.param("emulated", ["mocap:wrong@3.37,offset_m=0.02"], marks=pytest.mark.long),
        pytest.param(
            "emulated", ["mocap:off@2.34+1", "mocap:wrong@3.37,offset_m=-0.02"], marks=pytest.mark.long
        ),
        ("emulated", ["mocap:off@10.4"]),
    ],
)
def test_the_next_drive_does_not_begin_where_motion_capture_has_leapt_to(profile, faults, caplog):
    gone = faults == ["mocap:off@10.4"]
    with hil.open_bench(profile, seed=1, faults=faults, overrides={} if gone else FANLESS) as bench:
        drive(bench, 0)
        bench.look()
        if gone:
            with pytest.raises(hil.core.errors.DeviceTimeoutError):
                drive(bench, 1)
            assert bench.truth().pose_body_in_wall[0] < 0.24
        else:
            off, sigmas = drive(bench, 1)
            assert np.all(off < sigmas + 0.005)
            assert bench.truth().pose_body_in_wall[0] == pytest.approx(0.24, abs=0.01)
    assert "is taken to stand where the last drive left it" in caplog.text


@pytest.mark.parametrize(
    "fault",
    ["mocap:wrong@5.0,offset_m=0.5", pytest.param("tracker:jump@5.0,distance_m=0.3", marks=pytest.mark.long)],
)
def test_a_leap_is_no_way_that_the_robot_went_after_its_stop(fault):
    with hil.open_bench("emulated", seed=1, faults=[fault], overrides=FANLESS) as bench:
        drive(bench, 0)
        held = bench.look()
    assert held.state == "HELD"
    assert held.moved_m < 0.003


def test_in_a_clean_world_every_drive_begins_where_motion_capture_sees_the_robot(caplog):
    with hil.open_bench("emulated", seed=3, overrides=FANLESS) as bench:
        for number in range(2):
            off, sigmas = drive(bench, number)
            assert np.all(off < sigmas + 0.005)
    assert "is taken to stand" not in caplog.text


def test_without_motion_capture_a_second_drive_goes_on_where_the_first_ended():
    with hil.open_bench("emulated_floor", seed=1, overrides={"mocap": None}) as bench:
        for number in range(2):
            off, sigmas = drive(bench, number)
            assert np.all(off < sigmas + 0.005)


def test_a_robot_that_was_stopped_goes_on_from_where_it_stood():
    faults = ["mocap:wrong@3.37,offset_m=-0.02"]
    with hil.open_bench("emulated", seed=2, faults=faults) as bench:
        with pytest.raises(SafetyStop, match="sensors_disagree"):
            bench.drive(line((0, 0, 0), (0, 0.12, 0), duration_s=3.0))
        last = []
        bench.drive(line((0, 0.12, 0), (0, 0.24, 0), duration_s=3.0), on_cycle=last.append)
        off = np.abs(last[-1].state.pose_body_in_wall - bench.truth().pose_body_in_wall)[:2]
        assert np.all(off < 3.0 * np.sqrt(np.diag(last[-1].state.covariance)[:2]) + 0.005)
