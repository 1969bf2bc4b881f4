"""When a pose was measured: round trips, what they cannot show, and what is done without them."""

import dataclasses

import numpy as np
import pytest
from following import follow, kinds

from hil.core.errors import DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.tracker.mavlink.session import TimeSync
from hil.fakes.tracker.mavlink.chip import IDEAL

pytest.importorskip("pymavlink", reason="the extra mavlink is not installed")

MS = 1_000_000
LATE_NS = 20_300_000
"""Exposure to arrival at the ideal computer: 20 ms of its own and 0.3 ms of network."""


def error_ns(samples):
    return np.array([s.stamp.host_ns - s.stamp.t_ns - LATE_NS for s in samples])


@pytest.mark.parametrize("ppm", [0.0, 80.0])
def test_the_time_of_exposure_is_known_whatever_the_senders_clock_does(mavlink_bench, ppm):
    bench = mavlink_bench(options=dataclasses.replace(IDEAL, clock_ppm=ppm), seed=5)
    bench.driver.open()
    samples = follow(bench, 15.0)
    assert np.abs(error_ns(samples)).max() < 50_000
    assert np.all(np.diff([s.stamp.t_ns for s in samples]) > 0)
    assert kinds(samples).count(Status.OK) == len(samples)


def test_a_longer_latency_of_the_sender_is_seen_and_one_of_the_way_is_not_taken_for_it(mavlink_bench):
    """`tracker.latency_s` says 20 ms; the sender takes 60 ms, and the network 3 ms each way."""
    bench = mavlink_bench(options=dataclasses.replace(IDEAL, latency_s=0.06, network_s=0.003))
    bench.driver.open()
    ages = [s.stamp.host_ns - s.stamp.t_ns for s in follow(bench, 2.0)]
    np.testing.assert_allclose(ages, 63 * MS, atol=50_000)


def test_without_answers_the_quickest_arrivals_and_the_configured_latency_count(mavlink_bench):
    options = dataclasses.replace(IDEAL, answers_timesync=False, jitter_s=0.004, clock_ppm=30.0)
    bench = mavlink_bench(options=options, config={"latency_s": 0.0203})
    bench.driver.open()
    samples = follow(bench, 12.0)
    late = error_ns(samples)[500:]
    truly_late = late - late.min()
    assert truly_late.max() > 10 * MS
    assert abs(late.min()) < 0.3 * MS
    assert kinds(samples).count(Status.OK) == len(samples)


def test_a_way_that_is_longer_back_than_out_is_an_error_of_half_the_difference():
    sync = TimeSync()
    assert sync.due(0)
    sender_reads_ns = 1 * MS
    assert sync.answered(0, sender_reads_ns + 7_000 * MS, 6 * MS)
    assert sync.best(6 * MS).offset_ns - (-7_000 * MS) == 2 * MS
    assert sync.best(6 * MS).duration_ns == 6 * MS


def trip(sync, t_ms, offset_ms, out_ms=0.5, back_ms=0.5):
    """One round trip with a sender whose clock is `offset_ms` behind."""
    t_ns, arrived_ns = round(t_ms * MS), round((t_ms + out_ms + back_ms) * MS)
    assert sync.due(t_ns)
    return sync.answered(t_ns, round((t_ms + out_ms - offset_ms) * MS), arrived_ns)


def test_the_shortest_trip_of_the_last_seconds_counts():
    sync = TimeSync()
    for k, back_ms in enumerate([9.0, 0.5, 20.0, 5.0]):
        trip(sync, 300.0 * k, 100.0, back_ms=back_ms)
    assert sync.best(1000 * MS).offset_ns == 100 * MS
    for k in range(30):
        trip(sync, 1300.0 + 300.0 * k, 100.0 + 0.01 * k, back_ms=0.7)
    assert sync.best(10_000 * MS).offset_ns == pytest.approx(100.39 * MS, abs=0.01 * MS)


def test_a_step_that_two_trips_cannot_explain_starts_anew():
    sync = TimeSync()
    for k in range(4):
        trip(sync, 300.0 * k, 100.0, back_ms=0.5)
    trip(sync, 1500.0, 300.0, back_ms=4.0)
    assert sync.steps == 1
    assert sync.best(1600 * MS).offset_ns == pytest.approx(301.75 * MS)
    trip(sync, 1800.0, 300.0, back_ms=20.0)
    assert sync.steps == 1


def test_answers_that_were_not_asked_for_or_that_come_too_late_are_passed_over_and_old_ones_forgotten():
    sync = TimeSync()
    assert not sync.answered(5, 6, 7)
    assert sync.due(0)
    assert not sync.due(1 * MS)
    assert not sync.answered(0, 0, 400 * MS)
    assert sync.best(400 * MS) is None
    trip(sync, 500.0, 100.0)
    assert sync.best(600 * MS) is not None
    assert not sync.answered(round(500.0 * MS), 0, 502 * MS)
    assert sync.best(20_000 * MS) is None


def test_the_driver_answers_the_senders_own_requests(by_hand, common):
    bench = by_hand()
    bench.link.sent.clear()
    bench.link.arrive(common.MAVLink_timesync_message(0, 1234))
    bench.driver.read()
    answers = [m for m, to in bench.link.sent if m.get_type() == "TIMESYNC" and m.tc1]
    assert [(m.tc1, m.ts1) for m in answers] == [(bench.clock.now_ns(), 1234)]
    assert {to for _, to in bench.link.sent} == {("10.0.0.2", 14555)}


def test_poses_stamped_by_another_clock_than_timesyncs_fall_back_on_their_arrival(by_hand, common):
    """TIMESYNC is answered in time since boot, the poses bear the time of day: no offset joins them."""
    bench = by_hand()
    for _ in range(30):
        asked = [m for m, _ in bench.link.sent if m.get_type() == "TIMESYNC" and m.tc1 == 0]
        bench.link.sent.clear()
        for m in asked:
            bench.link.arrive(common.MAVLink_timesync_message(10**15 + bench.clock.now_ns(), m.ts1))
        samples = bench.send(0.05)
    ages = [s.stamp.host_ns - s.stamp.t_ns for s in samples]
    assert ages == [20 * MS] * 5
    assert kinds(samples) == [Status.OK] * 5
    (finding,) = (f for f in bench.driver.findings() if f.check == "time")
    assert finding.level == "warning"
    assert "another clock" in finding.found


def test_a_sender_that_starts_again_is_believed_when_its_poses_agree(mavlink_bench):
    bench = mavlink_bench("tracker:reset@2")
    bench.driver.open()
    samples = follow(bench, 3.0)
    states = kinds(samples)
    assert states.count(Status.RESET) == 1
    first = states.index(Status.RESET)
    assert set(states[:first]) == {Status.OK, Status.STALE}
    assert states[:first].count(Status.STALE) <= 21
    assert set(states[first + 1 : first + bench.config.reaccept_after]) == {Status.JUMP}
    assert set(states[first + bench.config.reaccept_after :]) == {Status.OK}
    assert np.all(np.diff([s.stamp.t_ns for s in samples]) > 0)
    assert np.all(np.diff([s.stamp.seq for s in samples]) == 1)
    assert samples[-1].stamp.device_ns < samples[0].stamp.device_ns
    assert np.abs(error_ns(samples[-20:])).max() < 50_000


def test_a_pose_that_comes_twice_or_after_a_newer_one_is_passed_over(by_hand, odometry):
    bench = by_hand()
    bench.send(0.1)
    newest = odometry(1.0 + bench.clock.now_ns() * 1e-9)
    older = odometry(1.0 + bench.clock.now_ns() * 1e-9 - 0.015)
    bench.link.arrive(newest, older)
    assert bench.driver.read() == ()
    assert bench.driver.counts["repeated"] == 2


def test_a_sender_without_a_clock_is_distinguished_from_a_silent_one(by_hand, odometry):
    """Every pose bears the same time stamp, though packets go on arriving."""
    bench = by_hand()

    def go_on(steps):
        for _ in range(steps):
            bench.clock.sleep_until_ns(bench.clock.now_ns() + 10 * MS)
            bench.link.arrive(odometry(2.0))
            bench.driver.read()

    with pytest.raises(DeviceTimeoutError, match=r"no usable pose for 2\.0 s; [0-9]+ poses were no newer"):
        go_on(300)
