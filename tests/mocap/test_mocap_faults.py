"""Every fault of the emulated capture server ends as data with a status or as a named device error."""

import numpy as np
import pytest
from following import kinds

from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.fakes.mocap.natnet.true_parameters import MocapTruthOptions
from hil.faults.fault import parse_fault


@pytest.mark.parametrize("fault", ["off@1", "drop@1,probability=1"])
def test_silence_raises_with_a_remedy(mocap_bench, watch, fault):
    bench = mocap_bench(f"mocap:{fault}")
    bench.driver.open()
    watch(bench, 1.5)
    with pytest.raises(DeviceTimeoutError, match="no usable frame") as caught:
        watch(bench, 4.0)
    assert caught.value.device == "mocap"
    assert caught.value.port == "127.0.0.1:1510"
    assert caught.value.remedy


@pytest.mark.parametrize("fault", ["mocap:off@1+0.4", "mocap:reset@1"])
def test_a_restarted_server_is_found_again_and_reported(mocap_bench, watch, fault):
    bench = mocap_bench(fault)
    bench.driver.open()
    samples = watch(bench, 4.0)
    marked = kinds(samples)
    back = marked.index(Status.RESET)
    assert set(marked[:back]) == {Status.OK}
    assert marked[back + 1 : back + 10] == [Status.JUMP] * 9
    assert set(marked[back + 11 :]) == {Status.OK}
    assert np.all(np.diff([s.stamp.seq for s in samples]) >= 1)
    x, y, _ = bench.plant.pose(samples[-1].stamp.t_ns)
    np.testing.assert_allclose(samples[-1].position_m[:2], [x, y], atol=1e-5)


@pytest.mark.parametrize("fault", ["unplug", "off"])
def test_a_server_that_was_away_is_found_again_and_frames_count_on(mocap_bench, watch, fault):
    """With `off` it starts its numbers anew."""
    bench = mocap_bench(f"mocap:{fault}@1+20")
    bench.driver.open()
    before = watch(bench, 0.9)[-1]
    with pytest.raises(DeviceTimeoutError):
        watch(bench, 4.0)
    with pytest.raises(DeviceError):
        bench.driver.reopen()
    bench.clock.sleep_until_ns(21_200_000_000)
    bench.driver.reopen()
    after = watch(bench, 1.0)
    assert set(kinds(after)) == {Status.OK}
    assert np.all(np.diff([before.stamp.seq, *(s.stamp.seq for s in after)]) >= 1)


def test_occlusion_is_reported_and_gives_no_numbers(mocap_bench, watch):
    bench = mocap_bench("mocap:intermittent@1+2,occlude=1,period_s=1,duty=0.5")
    bench.driver.open()
    samples = watch(bench, 4.0)
    hidden = [s for s in samples if s.status is not Status.OK]
    assert {s.status for s in hidden} == {Status.NOT_TRACKED}
    assert len(hidden) == pytest.approx(100, abs=3)
    assert not any(s.tracking_valid for s in hidden)
    assert all(np.isnan(s.position_m).all() for s in hidden)


def test_spontaneous_occlusions_can_be_had(mocap_bench, watch):
    bench = mocap_bench(options=MocapTruthOptions(occlusions_per_s=0.5, occlusion_s=0.2))
    bench.driver.open()
    share = np.mean([s.status is Status.NOT_TRACKED for s in watch(bench, 40.0)])
    assert 0.04 < share < 0.2


def test_frozen_poses_are_marked_and_then_an_error(mocap_bench, watch):
    bench = mocap_bench("mocap:stuck@1+1.5")
    bench.driver.open()
    marked = kinds(watch(bench, 4.0))
    assert marked.count(Status.FROZEN) == pytest.approx(130, abs=3)
    assert marked[-1] is Status.OK
    bench.world.faults.add(parse_fault("mocap:stuck"))
    with pytest.raises(DeviceTimeoutError, match="last status frozen"):
        watch(bench, 4.0)


def test_nan_and_random_poses_never_pass_as_good(mocap_bench, watch):
    bench = mocap_bench("mocap:garbage@1+1,nan=1", "mocap:garbage@3+1")
    bench.driver.open()
    samples = watch(bench, 4.5)
    nan = [s for s in samples if 1e9 < s.stamp.t_ns < 2e9]
    assert {s.status for s in nan} == {Status.NOT_FINITE}
    random = [s for s in samples if 3e9 < s.stamp.t_ns < 4e9]
    assert len(random) > 90
    assert {s.status for s in random} <= {Status.IMPLAUSIBLE, Status.NOT_FINITE, Status.JUMP}
    assert all(np.isnan(s.position_m).all() for s in nan)


def test_packets_of_random_bytes_are_counted(mocap_bench, watch):
    bench = mocap_bench("mocap:garbage@1+1,packets=1")
    bench.driver.open()
    samples = watch(bench, 3.0)
    assert bench.driver.counts["malformed"] == pytest.approx(200, abs=6)
    assert set(kinds(samples)) == {Status.OK}
    bench.world.faults.add(parse_fault("mocap:garbage,packets=1"))
    with pytest.raises(DeviceTimeoutError, match=r"packets passed over: .* malformed"):
        watch(bench, 4.0)


@pytest.mark.parametrize("kind", ["corrupt", "truncate"])
def test_damaged_packets_do_no_harm(mocap_bench, watch, kind):
    bench = mocap_bench(f"mocap:{kind}@0.5,probability=0.3", seed=5)
    bench.driver.open()
    samples = watch(bench, 10.0)
    assert len(samples) > 800
    for s in samples:
        if s.status is Status.OK and s.stamp.t_ns > 0:
            x, y, _ = bench.plant.pose(s.stamp.t_ns)
            assert np.hypot(*(s.position_m[:2] - (x, y))) < 0.05
    if kind == "truncate":
        assert bench.driver.counts["malformed"] > 100
        assert set(kinds(samples)) == {Status.OK}


def test_exchanged_bodies_are_a_jump(mocap_bench, watch):
    still = {"stuck_after_s": 1.0}  # the other body rests without noise
    bench = mocap_bench("mocap:jump@1+0.05", "mocap:jump@2+0.5", config=still)
    bench.driver.open()
    samples = watch(bench, 3.5)
    short = [s for s in samples if 1e9 < s.stamp.t_ns < 1.05e9]
    assert set(kinds(short)) == {Status.JUMP}
    assert set(kinds([s for s in samples if 1.06e9 < s.stamp.t_ns < 2e9])) == {Status.OK}
    swapped = kinds([s for s in samples if 2e9 < s.stamp.t_ns < 2.5e9])
    assert swapped[:10] == [Status.JUMP] * 10
    assert swapped[-1] is Status.OK
    assert samples[-1].status is Status.OK


def test_slow_late_and_repeated_frames(mocap_bench, watch):
    bench = mocap_bench(
        "mocap:slow@1+1,factor=5",
        "mocap:duplicate@3+1,probability=1",
        "mocap:delayed@5+1,delay_s=0.2",
        "mocap:delayed@7,delay_s=0.7",
    )
    bench.driver.open()
    watch(bench, 0.99)
    assert len(watch(bench, 1.0)) == pytest.approx(20, abs=2)
    watch(bench, 1.0)
    before = bench.driver.counts["repeated"]
    assert len(watch(bench, 1.0)) == pytest.approx(100, abs=2)
    assert bench.driver.counts["repeated"] - before == pytest.approx(300, abs=10)
    watch(bench, 1.0)
    late = watch(bench, 1.9)
    for s in late:
        x, y, _ = bench.plant.pose(s.stamp.t_ns)
        assert np.hypot(*(s.position_m[:2] - (x, y))) < 0.001
    ages = [(s.stamp.host_ns - s.stamp.t_ns) * 1e-9 for s in late]
    assert max(ages) == pytest.approx(0.2042, abs=0.015)
    assert watch(bench, 2.0)[-1].status is Status.STALE


def test_stalls_deliver_everything_late_and_in_order(mocap_bench, watch):
    bench = mocap_bench(options=MocapTruthOptions(stalls_per_s=2.0, gaps_per_s=0.0, clock_ppm=0.0), seed=4)
    bench.driver.open()
    samples = watch(bench, 10.0)
    assert np.all(np.diff([s.stamp.seq for s in samples]) == 1)
    assert 0.05 < max(s.stamp.host_ns - s.stamp.t_ns for s in samples) * 1e-9 < 0.25
    assert set(kinds(samples)) == {Status.OK}


def test_a_wrong_pose_looks_plausible(mocap_bench, watch):
    bench = mocap_bench("mocap:wrong@1,offset_m=0.02")
    bench.driver.open()
    last = watch(bench, 2.0)[-1]
    assert last.status is Status.OK
    assert last.position_m[0] - bench.plant.pose(last.stamp.t_ns)[0] == pytest.approx(0.02, abs=1e-5)
