"""A program that was stopped for a moment while the robot drove: nothing jumps to catch up."""

import numpy as np
import pytest

from hil.bench import open_bench
from hil.bench.loop_settings import motion_limits
from hil.core.clock import nanoseconds
from hil.core.errors import SafetyStop
from hil.live.velocity_input import CommandLines
from hil.live.velocity_reference import VelocityReference
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_run
from hil.robot.trajectories import line

PAUSED_S = 0.3


def driven(paused_s, recording=None, pauses=1):
    """A bench, records of a drive in which the clock leaps, and the place of the first record behind it.

    Args:
        paused_s: length of a leap; 0 for none.
        recording: path of a recording; None for none.
        pauses: number of leaps, in consecutive cycles.
    """
    bench = open_bench("emulated_floor", seed=0)
    if recording is not None:
        bench.add_sink(McapRecorder(recording, bench.header(), lossless=True))
    with bench:
        begun, leapt = [], []

        def leap(record):
            begun.append(record.start_ns)
            if paused_s and len(leapt) < pauses and record.start_ns >= begun[0] + nanoseconds(3.0):
                leapt.append(record)
                bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(paused_s))

        motion = bench.drive(line((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)), on_cycle=leap)
        return bench, motion.records, begun.index(leapt[0].start_ns) + 1 if leapt else 0


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return tmp_path_factory.mktemp("pause") / "drive.mcap"


@pytest.fixture(scope="module")
def paused(recording):
    return driven(PAUSED_S, recording)


def speeds_m_s(bench, rates_rad_s):
    return np.abs(rates_rad_s * bench.geometry.radius_m).max(axis=1)


def test_after_a_pause_the_wheels_start_as_gently_as_from_rest(paused):
    bench, records, at = paused
    limit_m_s2 = bench.config.control.acceleration_m_s2
    asked = speeds_m_s(bench, np.array([r.setpoint.wheel_rate_rad_s for r in records[at:]]))
    t_s = np.array([r.start_ns for r in records[at:]]) * 1e-9
    assert asked[0] < 0.01
    assert asked.max() > 0.08
    assert (np.diff(asked) <= 1.05 * limit_m_s2 * np.diff(t_s) + 1e-9)[: np.argmax(asked > 0.08)].all()
    measured = [r.measurements.wheels[-1].wheel_rate_rad_s for r in records[at + 5 : at + 200]]
    over_100_ms = speeds_m_s(bench, np.array(measured))
    assert (over_100_ms[10:] - over_100_ms[:-10]).max() < 1.5 * limit_m_s2 * 0.1


def test_the_reference_waits_and_the_drive_still_ends_at_its_goal(paused):
    bench, records, at = paused
    before, after = records[at - 1], records[at]
    apart_m = np.linalg.norm(after.reference.pose_in_wall[:2] - before.reference.pose_in_wall[:2])
    assert apart_m < 1.2 * 0.122 * bench.config.servos.watchdog_s
    poses = np.array([r.reference.pose_in_wall for r in records[at:]])
    t_s = np.array([r.start_ns for r in records[at:]]) * 1e-9
    rates = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / np.diff(t_s)
    reported = np.array([np.linalg.norm(r.reference.twist_body[:2]) for r in records[at:]])
    assert abs(rates - 0.5 * (reported[1:] + reported[:-1])).max() < 1e-3
    assert np.diff(reported).max() <= 1.05 * bench.config.control.acceleration_m_s2 * 0.01
    assert records[-1].reference.done
    np.testing.assert_allclose(records[-1].state.pose_body_in_wall[:2], (0.5, 0.0), atol=0.003)


def test_the_reference_stands_while_pause_follows_pause():
    """It once ran 45 mm ahead of wheels that stood, at the link of a silent bus on a busy computer."""
    bench, records, at = driven(0.1, pauses=8)
    ahead_m = np.linalg.norm(
        records[at + 7].reference.pose_in_wall[:2] - records[at - 1].reference.pose_in_wall[:2]
    )
    assert ahead_m < 1.2 * 0.122 * bench.config.servos.watchdog_s
    assert records[-1].reference.done
    np.testing.assert_allclose(records[-1].state.pose_body_in_wall[:2], (0.5, 0.0), atol=0.003)


def test_a_drive_of_nothing_but_pauses_is_stopped():
    with pytest.raises(SafetyStop, match=r"no cycle of the control loop took less than 0\.08 s"):
        driven(0.1, pauses=1000)


def test_a_drive_with_a_pause_repeats_in_replay(paused, recording):
    opened = open_recording(recording)
    assert [verify_run(opened.bench, run)["difference"] for run in opened.runs] == [None, None]


def test_a_pause_that_the_servos_do_not_notice_changes_nothing():
    _, records, at = driven(0.05)
    reported = np.array([np.linalg.norm(r.reference.twist_body[:2]) for r in records])
    assert reported[at] == pytest.approx(reported[at - 1], abs=0.01)
    assert records[at].reference.t_s == pytest.approx((records[at].start_ns - records[0].start_ns) * 1e-9)


class Held(CommandLines):
    """One command, for ever."""

    where = "test"

    def pending(self):
        return ["v 0.1 0 0"]

    def counts(self):
        return {}

    def close(self):
        pass


def test_a_commanded_velocity_starts_again_from_rest():
    bench = open_bench("emulated_floor", seed=0)
    limits = motion_limits(bench.config)
    reference = VelocityReference(
        Held(), np.zeros(3), bench.geometry.projection(), limits, stops_after_s=bench.config.servos.watchdog_s
    )
    bench.close()
    before = [reference(0.01 * k) for k in range(200)][-1]
    assert before.twist_body[0] == pytest.approx(0.1)
    after = [reference(2.3 + 0.01 * k) for k in range(100)]
    speed = np.array([r.twist_body[0] for r in after])
    assert after[0].pose_in_wall[0] - before.pose_in_wall[0] < 0.1 * 0.1
    assert speed[0] == 0.0
    assert np.diff(speed).max() <= 1.001 * limits.wheel_acceleration_m_s2 * 0.01
    assert speed[-1] == pytest.approx(0.1)
