"""The range finder on the bench of `bench.toml`: what it sees, and what becomes of its faults."""

import math

import pytest

from hil.bench import open_bench
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.recording.runs import RunStart

pytestmark = pytest.mark.needs("rangefinder")

NOSE_M, PLATE_M = 0.12, 2.0


def samples_of(motion):
    return [s for record in motion.records for s in record.inputs.of("rangefinder")]


def states(motion):
    return {s.status for s in samples_of(motion)}


def test_it_sees_the_plate_where_the_plate_is(bench, world):
    good = [s for s in samples_of(bench.observe(1.0)) if s.status is Status.OK]
    assert len(good) >= 95
    x_m = float(world.plant.truth().pose_body_in_wall[0])
    assert good[-1].distance_m == pytest.approx(PLATE_M - NOSE_M - x_m, abs=0.04)


def test_the_beam_turns_with_the_robot():
    with open_bench("bench.toml", overrides={"environment.start_pose": [0.0, 0.0, 0.25]}) as bench:
        turned = samples_of(bench.observe(0.5))[-1].distance_m
    assert turned == pytest.approx((PLATE_M - NOSE_M * math.cos(0.25)) / math.cos(0.25), abs=0.05)


@pytest.mark.parametrize("resolution", ["cm", "mm"])
def test_a_distance_has_the_resolution_that_was_asked_for(resolution):
    with open_bench("bench.toml", overrides={"rangefinder.resolution": resolution}) as bench:
        good = [s.distance_m for s in samples_of(bench.observe(0.5)) if s.status is Status.OK]
    centimetres = [abs(100.0 * d - round(100.0 * d)) < 1e-6 for d in good]
    assert all(centimetres) == (resolution == "cm")
    assert 1.8 < good[-1] < 1.95


@pytest.mark.parametrize(
    ("plate_x_m", "status"),
    [(0.25, Status.LOW_CONFIDENCE), (11.0, Status.LOW_CONFIDENCE), (-1.0, Status.LOW_CONFIDENCE)],
)
def test_what_it_cannot_see_is_no_distance(plate_x_m, status):
    with open_bench("bench.toml", overrides={"emulation.rangefinder.plate_x_m": plate_x_m}) as bench:
        sample = samples_of(bench.observe(0.3))[-1]
    assert sample.status is status
    assert math.isnan(sample.distance_m)


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        ("stuck@0.5", Status.FROZEN),
        ("garbage@0.5+0.3", Status.CRC),
        ("corrupt@0.5+0.5,probability=0.5", Status.CRC),
        ("wrong@0.5,strength=50", Status.LOW_CONFIDENCE),
        ("wrong@0.5,offset_m=9", Status.IMPLAUSIBLE),
        ("reset@0.5", Status.STARTING),
        ("off@0.5+0.5", Status.STARTING),
        ("unplug@0.5+0.5", Status.STARTING),
    ],
)
def test_a_fault_is_told_and_nothing_wrong_is_used(fault, status):
    with open_bench("bench.toml", faults=[f"rangefinder:{fault}"]) as bench:
        if status is None:
            with pytest.raises(DeviceError, match="rangefinder"):
                bench.observe(2.0)
            return
        motion = bench.observe(2.5)
    assert status in states(motion)
    assert all(math.isnan(s.distance_m) for s in samples_of(motion) if s.status is not Status.OK)
    good = [s.distance_m for s in samples_of(motion) if s.status is Status.OK]
    assert max(good) - min(good) < 0.05


def test_settings_come_back_after_a_loss_of_power():
    """The sensor forgets the millimetres; they are not read as centimetres, nor the other way round."""
    with open_bench("bench.toml", faults=["rangefinder:brownout@0.5+0.2"]) as bench:
        good = [s for s in samples_of(bench.observe(3.0)) if s.status is Status.OK]
    assert good[-1].stamp.t_ns - good[0].stamp.t_ns > 2e9
    assert 1.8 < good[-1].distance_m < 1.95
    assert any(abs(100.0 * s.distance_m - round(100.0 * s.distance_m)) > 1e-6 for s in good[-50:])


def test_a_silence_is_told_and_one_that_lasts_stops_the_run():
    with open_bench("bench.toml", faults=["rangefinder:off@0.5"]) as bench:
        motion = bench.observe(2.0)
        assert any("rangefinder" in e.source and "stale" in e.message for e in motion.events)
        with pytest.raises(DeviceTimeoutError, match=r"no distance for 3\.\d s"):
            bench.observe(5.0)


def test_a_rate_that_the_sensor_cannot_have_is_refused():
    with pytest.raises(ConfigError, match=r"rangefinder\.rate_hz: .*500 divided by"):
        load_bench("bench.toml", overrides={"rangefinder.rate_hz": 77})


@pytest.mark.fault("rangefinder", "wrong", offset_m=0.3)
def test_the_marker_for_faults_knows_it(bench):
    assert samples_of(bench.observe(0.5))[-1].distance_m == pytest.approx(PLATE_M - NOSE_M + 0.3, abs=0.05)


class Distances:
    """An estimator that keeps what it is given of the range finder."""

    def __init__(self, follows):
        self.follows, self.seen = follows, []

    def reset(self, state):
        self.follows.reset(state)

    def update(self, measurements):
        self.seen += [s.distance_m for s in measurements.added.get("rangefinder", ())]
        return self.follows.update(measurements)


def test_an_estimator_of_ones_own_is_given_its_distances(bench):
    pipeline = bench.make_pipeline(None)
    pipeline.estimator = own = Distances(pipeline.estimator)
    bench.run(pipeline, RunStart(bench.start_state(), "own"), lambda record: record.cycle >= 50)
    assert len(own.seen) > 40
    assert own.seen[-1] == pytest.approx(PLATE_M - NOSE_M, abs=0.05)
