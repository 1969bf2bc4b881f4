"""Every fault of the emulated camera ends as data with a status or as a named device error."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from following import kinds

from hil.config.tracker import T265Config
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError, FaultNotSupportedError
from hil.core.signals import Status
from hil.drivers.tracker.t265.driver import T265Tracker
from hil.fakes.tracker.t265.chip import SUPPORTED_FAULTS
from hil.fakes.tracker.true_parameters import IDEAL
from hil.faults.fault import parse_fault


def test_a_jump_is_marked_until_the_new_place_is_consistent(tracker_bench, follow):
    bench = tracker_bench("tracker:jump@2,distance_m=0.3")
    bench.driver.open()
    samples = follow(bench, 3.0)
    marked = kinds(samples)
    assert marked.count(Status.JUMP) == bench.config.reaccept_after
    first = marked.index(Status.JUMP)
    assert set(marked[first + bench.config.reaccept_after :]) == {Status.OK}
    step = samples[first].position_m - samples[first - 1].position_m
    assert np.linalg.norm(step) == pytest.approx(0.3, abs=0.002)


def test_poses_of_nan_are_marked_and_raise_when_they_last(tracker_bench, follow):
    bench = tracker_bench("tracker:garbage@1+1,nan=1")
    bench.driver.open()
    samples = follow(bench, 3.0)
    bad = [s for s in samples if s.status is not Status.OK]
    assert {s.status for s in bad} == {Status.NOT_FINITE}
    assert len(bad) == pytest.approx(200, abs=2)
    assert all(np.isnan(s.position_m).all() and np.isnan(s.quaternion_wxyz).all() for s in bad)
    bench.world.faults.add(parse_fault("tracker:garbage,nan=1"))
    with pytest.raises(DeviceTimeoutError, match="not finite"):
        follow(bench, 3.0)


def test_random_poses_never_pass_as_good(tracker_bench, follow):
    bench = tracker_bench("tracker:garbage@1", config={"fail_after_s": 60})
    bench.driver.open()
    samples = [s for s in follow(bench, 6.0) if s.stamp.t_ns > 1_000_000_000]
    assert len(samples) > 900
    assert Status.OK not in kinds(samples)
    assert {Status.NOT_FINITE, Status.IMPLAUSIBLE} <= set(kinds(samples))


def test_random_time_stamps_do_not_spoil_the_time_axis(tracker_bench, follow):
    bench = tracker_bench("tracker:garbage@1+0.05,clock=1")
    bench.driver.open()
    samples = follow(bench, 2.0)
    assert kinds(samples).count(Status.STALE) >= 9
    assert samples[-1].status is Status.OK
    assert all(0 <= s.stamp.host_ns - s.stamp.t_ns < 25_000_000 for s in samples)


def test_frozen_poses_are_marked_and_then_an_error(tracker_bench, follow):
    bench = tracker_bench("tracker:stuck@1+1.5")
    bench.driver.open()
    assert kinds(follow(bench, 3.0)).count(Status.FROZEN) == pytest.approx(280, abs=4)
    bench.world.faults.add(parse_fault("tracker:stuck"))
    with pytest.raises(DeviceTimeoutError, match="frozen"):
        follow(bench, 4.0)


def test_a_frozen_camera_is_frozen_whatever_it_says_of_its_confidence(tracker_bench, follow):
    """A camera that froze before it was sure of itself repeats that it is not tracked, too."""
    bench = tracker_bench("tracker:wrong@1,confidence=0", "tracker:stuck@2")
    bench.driver.open()
    before = [s for s in follow(bench, 2.0) if 1_100_000_000 < s.stamp.t_ns < 1_950_000_000]
    assert {s.status for s in before} == {Status.NOT_TRACKED}
    assert follow(bench, 0.5)[-1].status is Status.FROZEN


def test_wrong_scale_looks_plausible_and_wrong_confidence_is_reported(
    tracker_bench, travelling_plant, follow
):
    bench = tracker_bench(
        "tracker:wrong@1+1,scale=1.5",
        "tracker:wrong@3,confidence=0",
        plant=travelling_plant(twist=(0.1, 0.0, 0.0)),
    )
    bench.driver.open()
    samples = follow(bench, 3.4)
    good = [s for s in samples if s.stamp.t_ns < 2_950_000_000]
    assert {s.status for s in good} == {Status.OK}
    moved = np.linalg.norm(good[-1].position_m - good[0].position_m)
    t_s = (good[-1].stamp.t_ns - good[0].stamp.t_ns) * 1e-9
    assert moved == pytest.approx(0.1 * t_s + 0.05, abs=0.001)
    assert samples[-1].status is Status.NOT_TRACKED


def test_slow_drop_and_duplicate(tracker_bench, follow):
    bench = tracker_bench(
        "tracker:slow@1+1,factor=4", "tracker:drop@3+1,probability=0.5", "tracker:duplicate@5+1,probability=1"
    )
    bench.driver.open()
    assert len(follow(bench, 0.95 - bench.clock.now_ns() * 1e-9)) > 100
    follow(bench, 0.1)
    assert len(follow(bench, 0.9)) == pytest.approx(45, abs=2)
    follow(bench, 1.1)
    dropped = follow(bench, 0.9)
    assert 60 < len(dropped) < 120
    assert np.all(np.diff([s.stamp.seq for s in dropped]) >= 1)
    follow(bench, 1.1)
    doubled = follow(bench, 0.9)
    assert np.all(np.diff([s.stamp.seq for s in doubled]) == 1)
    assert bench.driver.repeated > 150


def test_late_poses_keep_their_time_and_very_late_ones_are_stale(tracker_bench, follow):
    bench = tracker_bench("tracker:delayed@1+1,delay_s=0.2", "tracker:delayed@3,delay_s=0.7")
    bench.driver.open()
    samples = follow(bench, 2.0)
    for s in samples:
        x, y, _ = bench.plant.pose(s.stamp.t_ns)[:3] - bench.plant.pose(samples[0].stamp.t_ns)
        assert np.hypot(x, y) == pytest.approx(np.linalg.norm(s.position_m), abs=0.05)
    ages = [s.stamp.host_ns - s.stamp.t_ns for s in samples]
    assert max(ages) == pytest.approx(220_000_000, abs=1_000_000)
    assert set(kinds(samples)) == {Status.OK}
    assert follow(bench, 1.9)[-1].status is Status.STALE


@pytest.mark.parametrize("fault", ["tracker:reset@2", "tracker:off@2+0.5"])
def test_a_restart_of_the_tracking_is_reported_and_numbers_go_on(
    tracker_bench, travelling_plant, follow, fault
):
    bench = tracker_bench(fault, plant=travelling_plant(twist=(0.2, 0.0, 0.0)))
    bench.driver.open()
    samples = follow(bench, 4.0)
    marked = kinds(samples)
    back = marked.index(Status.RESET)
    assert marked.count(Status.RESET) == 1
    assert marked[back + 1 : back + 20] == [Status.JUMP] * 19
    assert marked[-1] is Status.OK
    assert np.all(np.diff([s.stamp.seq for s in samples]) >= 1)
    assert np.linalg.norm(samples[back].position_m) < 0.01


def test_a_camera_that_finds_its_confidence_first_reports_its_restart_then(tracker_bench, follow):
    bench = tracker_bench("tracker:off@2+0.5", options=replace(IDEAL, settle_s=(0.05, 0.15, 0.5)))
    bench.driver.open()
    marked = kinds(follow(bench, 4.0))
    back = marked.index(Status.RESET)
    assert marked[back - 1] is Status.LOW_CONFIDENCE
    assert marked[back + 1 : back + 20] == [Status.JUMP] * 19
    assert marked.count(Status.RESET) == 1
    assert marked[-1] is Status.OK


@pytest.mark.parametrize("backend", ["real", "emulated"])
def test_silence_raises_with_a_remedy(tracker_bench, follow, backend):
    bench = tracker_bench("tracker:intermittent@1,duty=1", config={"backend": backend})
    bench.driver.open()
    follow(bench, 2.0)
    with pytest.raises(DeviceTimeoutError, match="close and open the tracker") as caught:
        follow(bench, 2.0)
    assert ("USB 3" in str(caught.value)) == (backend == "real"), "an emulated camera has no cable"


def test_a_camera_that_was_away_counts_on_and_says_that_its_place_is_new(tracker_bench, follow):
    bench = tracker_bench("tracker:unplug@1+3")
    bench.driver.open()
    before = follow(bench, 0.9)[-1]
    with pytest.raises(DeviceTimeoutError):
        follow(bench, 5.0)
    with pytest.raises(DeviceError, match="No device connected"):
        bench.driver.reopen()
    assert bench.driver.identity() == {}
    bench.clock.sleep_until_ns(4_100_000_000)
    bench.driver.reopen()
    after = follow(bench, 1.0)
    assert after[0].status is Status.RESET
    assert after[-1].status is Status.OK
    seqs = [before.stamp.seq, *(s.stamp.seq for s in after)]
    assert np.all(np.diff(seqs) >= 1)
    assert seqs[-1] - seqs[0] < 500


def test_a_full_queue_loses_the_oldest_and_counts_them(tracker_bench):
    bench = tracker_bench(config={"queue_length": 50})
    bench.driver.open()
    bench.clock.sleep_until_ns(2_000_000_000)
    samples = bench.driver.read()
    assert len(samples) == 50
    assert bench.driver.overflowed > 200
    assert samples[-1].stamp.host_ns > 1_990_000_000


def test_identity_serial_and_model_are_checked(tracker_bench):
    bench = tracker_bench()
    bench.driver.open()
    identity = bench.driver.identity()
    assert identity["model"] == "Intel RealSense T265"
    assert identity["serial"] == bench.camera.serial
    assert identity["firmware"] == "0.2.0.951"
    bench.driver.open()
    other = tracker_bench(config={"serial": "17"})
    with pytest.raises(DeviceError, match="serial number 17"):
        other.driver.open()
    depth = tracker_bench(model="Intel RealSense D435")
    with pytest.raises(DeviceError, match="D435"):
        depth.driver.open()


def test_no_pose_at_all_is_a_time_out_at_open(tracker_bench):
    bench = tracker_bench("tracker:off", config={"open_timeout_s": 1.0})
    with pytest.raises(DeviceTimeoutError, match="no usable pose for 1"):
        bench.driver.open()
    bench.driver.close()


@pytest.mark.parametrize("kind", ["bus_off", "corrupt"])
def test_faults_without_meaning_are_refused(tracker_bench, kind):
    assert kind not in SUPPORTED_FAULTS
    with pytest.raises(FaultNotSupportedError):
        tracker_bench().world.faults.add(parse_fault(f"tracker:{kind}"))


class Mumbling:
    """A pipeline whose frames are not what they should be."""

    def __init__(self, camera):
        self.camera, self.frames = camera, []

    def resolve(self):
        return self.camera.pipeline().resolve()

    def start(self, config, callback):
        self.pipeline = self.camera.pipeline()
        self.callback = callback
        return self.pipeline.start(config, callback)

    def stop(self):
        raise RuntimeError("the device is gone")


class Strange:
    def is_pose_frame(self):
        return False


class Broken(Strange):
    def is_pose_frame(self):
        raise RuntimeError("null pointer passed for argument")


def test_frames_without_pose_are_counted_and_a_failing_stop_is_quiet(tracker_bench):
    bench = tracker_bench()
    pipeline = Mumbling(bench.camera)
    driver = T265Tracker(T265Config(), bench.clock, pipeline=pipeline)
    driver.open()
    for frame in (Strange(), Broken(), Strange()):
        pipeline.callback(frame)
    assert driver.malformed == 3
    driver.close()
    driver.close()


def test_a_missing_library_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(DeviceError, match=r"t265.*2\.53\.1") as caught:
        T265Tracker(T265Config(), MonotonicClock()).open()
    assert caught.value.exit_code == 3
