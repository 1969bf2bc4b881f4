"""The contract suite and the doctor, on drivers that deliver a sample more often than it was measured."""

from dataclasses import replace

import pytest

import hil
from hil.bench.contract.device_under_test import Broken, Subject
from hil.bench.contract.interface_promises import delivered_once, samples_in_time
from hil.bench.doctor.examination import examine

KINDS = ("imu", "tracker")


def same(sample):
    return sample


def anew(sample):
    """As if it were another one, measured a little later."""
    stamp = sample.stamp
    return replace(sample, stamp=replace(stamp, t_ns=stamp.t_ns + 1000))


def twice(bench, kind, again):
    device = bench.devices.get(kind)
    read = device.read
    device.read = lambda: tuple(one for s in read() for one in (s, again(s)))


def opened():
    bench = hil.open_bench("emulated")
    bench.begin()
    return bench


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_sample_again_is_a_promise_broken(kind):
    bench = opened()
    twice(bench, kind, same)
    subject = Subject(bench, kind)
    with pytest.raises(Broken, match=r"came twice; expected each once; fix the driver"):
        delivered_once(subject)
    with pytest.raises(Broken, match=r"samples in 1 s; expected about|times of measurement go back"):
        samples_in_time(subject)
    bench.close()


@pytest.mark.parametrize("kind", KINDS)
def test_more_samples_than_the_rate_allows_are_a_promise_broken(kind):
    bench = opened()
    twice(bench, kind, anew)
    subject = Subject(bench, kind)
    assert delivered_once(subject) == "each once"
    with pytest.raises(Broken, match=r"samples in 1 s; expected about \d+: no more than its rate allows"):
        samples_in_time(subject)
    bench.close()


def test_the_doctor_finds_that_samples_come_twice():
    bench = hil.open_bench("emulated")
    for kind in ("imu", "tracker"):
        twice(bench, kind, same)
    found = {f.device: f for f in examine(bench, watch_s=0.5) if f.check == "samples"}
    for kind in ("imu", "tracker"):
        assert found[kind].level == "failure"
        assert "samples where" in found[kind].found
    assert found["servos"].level == "ok"
