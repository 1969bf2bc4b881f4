"""Samples that cannot be used are reported once each; a lost packet is not worth a word."""

import numpy as np
import pytest

from hil.core.errors import UsageError
from hil.core.signals import (
    EncoderSample,
    ImuSample,
    Inputs,
    MocapSample,
    Stamp,
    Status,
    TrackerSample,
    samples_of,
)
from hil.loop.checks.sensor_status import SensorStatus

PERIOD_NS = 10_000_000
NAN = np.full(4, np.nan)


def tracker(stamp, status):
    return TrackerSample(stamp, NAN[:3], NAN, NAN[:3], NAN[:3], 3, status)


def imu(stamp, status):
    return ImuSample(stamp, NAN, NAN[:3], NAN[:3], NAN[:3], (3, 3, 3, 3), status)


def mocap(stamp, status):
    return MocapSample(stamp, NAN[:3], NAN, True, 0.0, 0.0, status)


def encoders(stamp, status):
    return EncoderSample(stamp, NAN, (Status.OK, status, Status.OK, Status.OK), (0,) * 4)


MAKERS = {"tracker": tracker, "imu": imu, "mocap": mocap, "encoders": encoders}


def watched(device, statuses, stale_s=None, begin=0):
    """Events of a device that sends one sample per cycle from cycle `begin` on; None is no sample."""
    watch, events = SensorStatus(stale_s or {}), []
    for k, status in enumerate(statuses, begin):
        stamp = Stamp(k * PERIOD_NS, k * PERIOD_NS, k)
        samples = () if status is None else (MAKERS[device](stamp, status),)
        watch.judge(Inputs(k, k * PERIOD_NS, **{device: samples}), events)
    return events


TOLD = [
    (Status.FROZEN, "frozen"),
    (Status.IMPLAUSIBLE, "impossible values"),
    (Status.NOT_FINITE, "NaN or infinity"),
    (Status.JUMP, "jumped"),
    (Status.RESET, "started again"),
    (Status.HARDWARE_ERROR, "hardware error"),
]


@pytest.mark.parametrize("device", list(MAKERS))
@pytest.mark.parametrize(("status", "word"), TOLD)
def test_what_cannot_be_used_is_reported_once(device, status, word):
    (event,) = watched(device, [Status.OK] * 3 + [status] * 300 + [Status.OK] * 3)
    assert (event.t_ns, event.level, event.source) == (3 * PERIOD_NS, "warning", device)
    assert word in event.message
    assert event.message.startswith("BL ") == (device == "encoders")


def test_it_is_reported_again_after_a_second_without():
    apart = [Status.IMPLAUSIBLE] + [Status.OK] * 100
    assert len(watched("imu", [*apart, Status.IMPLAUSIBLE])) == 2
    assert len(watched("imu", [*apart[:-1], Status.IMPLAUSIBLE])) == 1


@pytest.mark.parametrize("device", list(MAKERS))
@pytest.mark.parametrize("status", [None, Status.TIMEOUT, Status.CRC, Status.LOW_CONFIDENCE, Status.STARTING])
def test_what_passes_is_not_worth_a_word(device, status):
    assert watched(device, [Status.OK, status, Status.OK, status, status]) == []


def test_a_silence_is_reported_when_it_has_lasted_and_so_is_its_end():
    reported = watched("imu", [Status.OK, *[None] * 60, Status.OK, Status.OK], {"imu": 0.5})
    assert [(e.t_ns // PERIOD_NS, e.level, e.message) for e in reported] == [
        (51, "warning", "stale for 0.510 s"),
        (61, "info", "answers again, after 0.61 s"),
    ]


@pytest.mark.parametrize(("missing", "reported"), [(90, []), (150, ["answers again, after 1.51 s"])])
def test_a_sensor_that_was_away_says_for_how_long(missing, reported):
    """Also one whose silence stops nothing."""
    for begin in (0, 300):
        events = watched("mocap", [Status.OK, *[None] * missing, Status.OK], begin=begin)
        assert [e.message for e in events] == reported


def test_times_are_counted_from_the_last_sample_and_not_from_the_start():
    reported = watched("imu", [Status.OK, *[None] * 60, Status.OK], {"imu": 0.5}, begin=300)
    assert [e.message for e in reported] == ["stale for 0.510 s", "answers again, after 0.61 s"]
    watch = SensorStatus({})
    assert watch.away_s("mocap", 5 * PERIOD_NS) == 0.0
    watch.judge(Inputs(300, 300 * PERIOD_NS, mocap=(mocap(Stamp(0, 0, 0), Status.OK),)), [])
    assert watch.away_s("mocap", 350 * PERIOD_NS) == pytest.approx(0.5)


def test_a_sensor_that_sends_on_was_never_away():
    assert watched("mocap", [Status.OK] * 400) == []


def test_frozen_samples_are_a_silence_too():
    reported = watched("tracker", [Status.OK, *[Status.FROZEN] * 60], {"tracker": 0.5})
    assert [e.message.split()[0] for e in reported] == ["repeats", "stale"]


@pytest.mark.parametrize("name", ["health", "added", "cycle", "t_ns"])
def test_a_field_of_inputs_that_is_no_kind_is_refused_as_one(name):
    """A check of it would be silent for ever."""
    with pytest.raises(UsageError, match=rf"{name} is no kind of devices; read it as `inputs\.{name}`"):
        Inputs(0, 0).of(name)
    with pytest.raises(UsageError, match=name):
        samples_of(name)
    assert Inputs(0, 0).of("rangefinder") == ()
