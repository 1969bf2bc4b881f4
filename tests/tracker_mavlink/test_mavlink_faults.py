"""Every fault of the emulated computer ends as data with a status or as a named device error."""

from dataclasses import replace

import numpy as np
import pytest
from following import follow, kinds, until

from hil.core.errors import DeviceTimeoutError, FaultNotSupportedError
from hil.core.signals import Status
from hil.fakes.tracker.mavlink.chip import IDEAL
from hil.fakes.tracker.mavlink.faults import SUPPORTED_FAULTS
from hil.faults.fault import parse_fault

pytest.importorskip("pymavlink", reason="the extra mavlink is not installed")


def position_step(samples, index):
    return np.linalg.norm(samples[index].position_m - samples[index - 1].position_m)


def test_a_reset_count_stops_the_use_of_poses_until_they_are_steady(mavlink_bench):
    """A correction of 5 mm looks like motion: only the count shows that the frame is another one."""
    bench = mavlink_bench("tracker:jump@2,distance_m=0.005")
    bench.driver.open()
    samples = follow(bench, 3.0)
    states = kinds(samples)
    first = states.index(Status.RESET)
    assert position_step(samples, first) == pytest.approx(0.005, abs=0.002)
    assert states[:first] == [Status.OK] * first
    after = bench.config.reaccept_after
    assert states[first:] == [Status.RESET] + [Status.JUMP] * (after - 1) + [Status.OK] * (
        len(states) - first - after
    )


def test_a_jump_without_a_new_count_is_reported_by_its_distance(mavlink_bench):
    bench = mavlink_bench(
        "tracker:jump@2,distance_m=0.3,announced=0", "tracker:jump@4,distance_m=0.005,announced=0"
    )
    bench.driver.open()
    samples = follow(bench, 5.0)
    states = kinds(samples)
    first = states.index(Status.JUMP)
    assert position_step(samples, first) == pytest.approx(0.3, abs=0.002)
    assert states.count(Status.JUMP) == bench.config.reaccept_after
    assert Status.RESET not in states


def test_poses_of_nan_are_marked_and_raise_when_they_last(mavlink_bench):
    bench = mavlink_bench("tracker:garbage@2+1,nan=1")
    bench.driver.open()
    samples = until(bench, 4.0)
    bad = [s for s in samples if s.status is not Status.OK]
    assert {s.status for s in bad} == {Status.NOT_FINITE}
    assert len(bad) == pytest.approx(100, abs=2)
    assert all(np.isnan(s.position_m).all() and np.isnan(s.quaternion_wxyz).all() for s in bad)
    bench.world.faults.add(parse_fault("tracker:garbage,nan=1"))
    with pytest.raises(DeviceTimeoutError, match="not finite"):
        follow(bench, 3.0)


def test_random_poses_never_pass_as_good(mavlink_bench):
    bench = mavlink_bench("tracker:garbage@2", config={"fail_after_s": 60})
    bench.driver.open()
    until(bench, 2.05)
    states = kinds(follow(bench, 4.0))
    assert len(states) > 350
    assert Status.OK not in states
    assert {Status.NOT_FINITE, Status.IMPLAUSIBLE} <= set(states)


def test_random_time_stamps_do_not_spoil_the_time_axis(mavlink_bench):
    bench = mavlink_bench("tracker:garbage@2+0.1,clock=1")
    bench.driver.open()
    samples = until(bench, 3.0)
    assert kinds(samples).count(Status.STALE) >= 9
    assert set(kinds(samples[-70:])) == {Status.OK}
    assert all(0 <= s.stamp.host_ns - s.stamp.t_ns < 25_000_000 for s in samples)


def test_random_packets_are_counted_and_then_an_error(mavlink_bench):
    bench = mavlink_bench("tracker:garbage@2,packets=1")
    bench.driver.open()
    with pytest.raises(DeviceTimeoutError, match=r"no usable pose for 2.0 s; [0-9]+ damaged pieces"):
        until(bench, 6.0)
    assert bench.clock.now_ns() < 4_300_000_000


def test_frozen_poses_are_marked_and_then_an_error(mavlink_bench):
    bench = mavlink_bench("tracker:stuck@2+1.5")
    bench.driver.open()
    assert kinds(until(bench, 4.0)).count(Status.FROZEN) == pytest.approx(100, abs=3)
    bench.world.faults.add(parse_fault("tracker:stuck"))
    with pytest.raises(DeviceTimeoutError, match="frozen"):
        follow(bench, 4.0)


def test_a_frozen_sender_is_frozen_whatever_it_says_of_its_quality(mavlink_bench):
    bench = mavlink_bench("tracker:wrong@2,quality=-1", "tracker:stuck@3")
    bench.driver.open()
    assert until(bench, 2.95)[-1].status is Status.NOT_TRACKED
    assert until(bench, 4.0)[-1].status is Status.FROZEN


def test_wrong_scale_looks_plausible_and_wrong_quality_and_frames_are_reported(
    mavlink_bench, travelling_plant
):
    bench = mavlink_bench(
        "tracker:wrong@2+1,scale=1.5",
        "tracker:wrong@4+1,quality=-1",
        "tracker:wrong@5+1,quality=5",
        "tracker:wrong@6+1,frame=0",
        plant=travelling_plant(twist=(0.1, 0.0, 0.0)),
    )
    bench.driver.open()
    good = until(bench, 3.95)
    assert set(kinds(good)) == {Status.OK}
    t_s = (good[-1].stamp.t_ns - good[0].stamp.t_ns) * 1e-9
    moved = np.linalg.norm(good[-1].position_m - good[0].position_m)
    assert moved == pytest.approx(0.1 * t_s + 0.05, abs=0.0015)
    for end_s, status in ((4.95, Status.NOT_TRACKED), (5.95, Status.LOW_CONFIDENCE), (6.95, Status.PROTOCOL)):
        sample = until(bench, end_s)[-1]
        assert sample.status is status
        assert np.isnan(sample.position_m).all() == (status is not Status.LOW_CONFIDENCE)
    assert until(bench, 8.0)[-1].status is Status.OK


def test_slow_drop_and_duplicate(mavlink_bench):
    bench = mavlink_bench(
        "tracker:slow@2+1,factor=4", "tracker:drop@4+1,probability=0.5", "tracker:duplicate@6+1,probability=1"
    )
    bench.driver.open()
    until(bench, 2.05)
    assert len(until(bench, 3.0)) == pytest.approx(24, abs=2)
    until(bench, 4.05)
    assert len(until(bench, 5.0)) == pytest.approx(47, abs=15)
    assert bench.driver.counts["lost"] > 20
    until(bench, 6.05)
    assert len(until(bench, 7.0)) == pytest.approx(95, abs=3)
    assert bench.driver.counts["repeated"] > 90


@pytest.mark.parametrize("kind", ["corrupt", "truncate"])
def test_damaged_packets_are_counted_and_never_believed(mavlink_bench, kind):
    bench = mavlink_bench(f"tracker:{kind}@2,probability=0.5")
    bench.driver.open()
    until(bench, 2.05)
    samples = follow(bench, 2.0)
    assert 60 <= len(samples) <= 140
    assert set(kinds(samples)) == {Status.OK}
    counts = bench.driver.counts
    assert counts["lost"] > 50
    assert counts["malformed"] > 50 or kind == "truncate"


def test_delayed_poses_are_stale_and_intermittent_ones_are_gaps(mavlink_bench):
    bench = mavlink_bench("tracker:delayed@2+1,delay_s=0.8", "tracker:intermittent@5,period_s=1,duty=0.4")
    bench.driver.open()
    until(bench, 2.05)
    late = [s for s in until(bench, 4.5) if s.stamp.host_ns - s.stamp.t_ns > 700_000_000]
    assert len(late) > 90
    assert set(kinds(late)) == {Status.STALE}
    until(bench, 5.0)
    arrived = [s.stamp.host_ns for s in until(bench, 9.0)]
    assert max(np.diff(arrived)) == pytest.approx(400e6, abs=25e6)


def test_silence_is_an_error_after_a_while_and_the_tracker_can_be_opened_again(mavlink_bench):
    bench = mavlink_bench("tracker:unplug@2+4", config={"open_timeout_s": 1.0})
    bench.driver.open()
    with pytest.raises(DeviceTimeoutError, match=r"no usable pose for 2.0 s"):
        until(bench, 6.0)
    with pytest.raises(DeviceTimeoutError, match="nothing arrives within 1 s") as caught:
        bench.driver.open()
    assert caught.value.exit_code == 3
    assert bench.driver.identity() == {}
    bench.clock.sleep_until_ns(6_500_000_000)
    bench.driver.open()
    assert set(kinds(follow(bench, 1.0))) == {Status.OK}


def test_a_sender_that_restarts_without_confidence_reports_so_with_its_first_good_pose(mavlink_bench):
    bench = mavlink_bench("tracker:off@2+0.5", options=replace(IDEAL, settle_s=(0.05, 0.15, 0.0)))
    bench.driver.open()
    states = kinds(until(bench, 5.0))
    assert states.count(Status.RESET) == 1
    assert states[states.index(Status.RESET) - 1] in (Status.NOT_TRACKED, Status.LOW_CONFIDENCE)
    assert states[-1] is Status.OK


def test_a_full_queue_loses_the_oldest_and_counts_them(mavlink_bench):
    bench = mavlink_bench(config={"queue_length": 50})
    bench.driver.open()
    bench.clock.sleep_until_ns(4_000_000_000)
    samples = bench.driver.read()
    assert len(samples) == 50
    assert bench.driver.counts["overflowed"] > 100
    assert samples[-1].stamp.host_ns > 3_980_000_000


def test_a_fault_without_meaning_is_refused(mavlink_bench):
    assert "bus_off" not in SUPPORTED_FAULTS
    with pytest.raises(FaultNotSupportedError):
        mavlink_bench().world.faults.add(parse_fault("tracker:bus_off"))
