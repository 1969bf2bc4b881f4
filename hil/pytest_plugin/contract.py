"""A ready-made test module: what every device promises, whoever answers on the wire.

In a project of your own, a test module needs one line::

    from hil.pytest_plugin.contract import *

Each device of the bench is tested: that of the ini key `hil_bench`, or of `--bench`. Where all of it is
emulated the suite runs twice, in virtual time and at the wire in real time; a bench with a real device is
taken as it is. Nothing is commanded. The importing module may say which kinds are meant (`KINDS = ("imu",)`),
name further models, each of which is tested in a bench that has it instead (`MODELS = (("imu", "my_imu"),)`),
and set keys of the bench file for the tests at the wire (`OVERRIDES = {"servos.reply_slack_s": 0.02}`).
Tests of its own can stand beside: their `bench` is the plugin's.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Generator
from dataclasses import dataclass, fields, replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hil.bench import Bench
from hil.bench.doctor import examine
from hil.procedure.bench_source import BenchSource
from hil.pytest_plugin.selection import plainly, source_of
from hil.pytest_plugin.selfcheck import due
from hil.recording.compare import first_difference
from hil.recording.cycle_codec import CycleEncoder
from hil.recording.cycle_decoder import CycleDecoder
from hil.recording.cycle_layout import DTYPES, describe
from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.errors import DeviceError
from hil.vocabulary.finding import Finding
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import kinds
from hil.vocabulary.signals import KINDS as OURS
from hil.vocabulary.signals import (
    CycleRecord,
    Inputs,
    Measurements,
    RobotState,
    ServoSetpoint,
    Status,
    WheelSetpoint,
    worst,
)

__all__ = [
    "closed_bench",
    "collect",
    "device",
    "findings",
    "pytest_generate_tests",
    "test_a_read_never_waits_for_the_next_sample",
    "test_a_sample_is_delivered_once",
    "test_an_open_device_says_what_it_is_and_a_closed_one_says_nothing",
    "test_it_can_be_opened_again",
    "test_no_data_is_never_a_number",
    "test_reading_a_closed_device_is_a_named_error",
    "test_samples_are_recorded_bit_for_bit",
    "test_samples_arrive_in_order_with_stamps_that_make_sense",
    "test_the_doctor_finds_no_failure",
    "test_the_same_seed_gives_the_same_samples",
    "watched",
]

VIRTUAL, WIRE, GIVEN = "virtual", "wire", "given"
WATCH_S, SHORT_S = 1.0, 0.2
SHARE = 0.7
"""Of the samples that are due: this computer's load may cost some."""
OLDEST_NS, EARLY_NS = nanoseconds(0.3), nanoseconds(0.001)
LONGEST_READ_NS = nanoseconds(0.06)
NOTHING = (Status.TIMEOUT, Status.CRC, Status.PARITY, Status.PROTOCOL)
"""Statuses of samples that hold no data at all."""

Collect = Callable[[Any, float], list[Any]]


@dataclass(frozen=True)
class Watched:
    """A device that was opened, read for a while and closed: its samples, and when it was read."""

    kind: str
    samples: list[Any]
    began_ns: int
    ended_ns: int


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Which devices of which bench, in which time."""
    names = metafunc.fixturenames
    if "backend" not in names and "kind" not in names:
        return
    try:
        source = source_of(metafunc.config)
        present = tuple(source.config.devices())
        real = source.real
    except Exception as error:
        raise pytest.UsageError(str(error)) from None
    ways = [GIVEN] if real else [VIRTUAL, WIRE]
    module = metafunc.module
    wanted = getattr(module, "KINDS", present)
    if "kind" not in names:
        metafunc.parametrize("backend", ways, scope="module")
        return
    asked = [(way, kind) for way in ways for kind in present if kind in wanted]
    if not real:
        further = getattr(module, "MODELS", ())
        asked += [(f"{way} {kind}={model}", kind) for way in ways for kind, model in further]
    metafunc.parametrize(("backend", "kind"), asked, scope="module")


def source_for(backend: str, config: pytest.Config, module: ModuleType) -> BenchSource:
    """The bench of the session in virtual time, at the wire, or as it is; with another model where named."""
    source, (way, _, chosen) = source_of(config), backend.partition(" ")
    overrides = dict(source.overrides)
    if way == WIRE:
        overrides |= getattr(module, "OVERRIDES", {})
    if chosen:
        kind, _, model = chosen.partition("=")
        overrides[f"{kind}.model"] = model
    realtime = source.realtime if way == GIVEN else way == WIRE
    return replace(source, realtime=realtime, overrides=overrides)


def opened(backend: str, request: pytest.FixtureRequest) -> Bench:
    """The bench, closed; skipped where a driver needs an extra of this package that is not installed."""
    with plainly():
        try:
            return source_for(backend, request.config, request.module).open()
        except DeviceError as error:
            if "the extra" not in str(error):
                raise
            pytest.skip(str(error))


def read_for(bench: Bench, device: Any, duration_s: float) -> list[Any]:
    """Everything that a device delivers when it is read at the loop rate."""
    period_ns = round(NS_PER_S / bench.config.loop.rate_hz)
    samples, next_ns = list[Any](), bench.clock.now_ns()
    for _ in range(round(duration_s * bench.config.loop.rate_hz)):
        samples += device.read()
        next_ns += period_ns
        bench.clock.sleep_until_ns(next_ns)
    return samples


def arrays_of(sample: type[Any]) -> list[str]:
    """Names of the fields of a sample that hold arrays."""
    hints = typing.get_type_hints(sample)
    return [f.name for f in fields(sample) if hints[f.name] == Array]


def by_channel(values: Array, states: tuple[Status, ...]) -> list[tuple[Array, tuple[Status, ...]]]:
    """Parts of an array with the statuses that speak of each: rows where it has one for every channel.

    Whole numbers and booleans have no NaN, so nothing is asked of them.
    """
    if values.dtype.kind != "f":
        return []
    if values.ndim and len(values) == len(states):
        return [(row, (state,)) for row, state in zip(values, states, strict=True)]
    return [(values, states)]


@pytest.fixture(scope="module")
def closed_bench(backend: str, request: pytest.FixtureRequest) -> Generator[Bench, None, None]:
    """A bench whose world runs and whose devices are still closed."""
    found = opened(backend, request)
    found.begin()
    yield found
    found.close()


@pytest.fixture
def device(closed_bench: Bench, kind: str) -> Generator[Any, None, None]:
    """One opened device after the other."""
    found = closed_bench.rig.get(kind)
    found.open()
    yield found
    found.close()


@pytest.fixture(scope="module")
def collect(closed_bench: Bench) -> Collect:
    """Read a device at the loop rate for a while."""
    return lambda device, duration_s: read_for(closed_bench, device, duration_s)


@pytest.fixture(scope="module")
def watched(closed_bench: Bench, kind: str) -> Watched:
    """A device that was opened, read for a while and closed."""
    found = closed_bench.rig.get(kind)
    found.open()
    began_ns = closed_bench.clock.now_ns()
    samples = read_for(closed_bench, found, WATCH_S)
    ended_ns = closed_bench.clock.now_ns()
    found.close()
    return Watched(kind, samples, began_ns, ended_ns)


def test_an_open_device_says_what_it_is_and_a_closed_one_says_nothing(device: Any) -> None:
    """Identity is text by text; closing twice is allowed."""
    identity = device.identity()
    assert identity
    assert all(isinstance(k, str) and isinstance(v, str) and v for k, v in identity.items())
    device.close()
    assert not device.identity()
    device.close()


def test_it_can_be_opened_again(device: Any, collect: Collect) -> None:
    """After it was closed, and without being asked to, it delivers as before."""
    assert collect(device, SHORT_S)
    device.close()
    device.open()
    assert collect(device, SHORT_S)


def test_reading_a_closed_device_is_a_named_error(device: Any) -> None:
    """A `DeviceError` with the device's name."""
    device.close()
    with pytest.raises(DeviceError, match=device.name):
        device.read()


def test_samples_arrive_in_order_with_stamps_that_make_sense(watched: Watched, closed_bench: Bench) -> None:
    """Nearly all samples that are due come, are good, and say when they were measured."""
    good = [s for s in watched.samples if worst(s) is Status.OK]
    assert len(good) >= max(2.0, SHARE * due(closed_bench, watched.kind, watched.samples, WATCH_S))
    assert np.all(np.diff([s.stamp.t_ns for s in good]) > 0)
    assert np.all(np.diff([s.stamp.seq for s in watched.samples]) >= 0)
    for sample in good:
        stamp = sample.stamp
        assert watched.began_ns - OLDEST_NS <= stamp.t_ns <= stamp.host_ns + EARLY_NS
        assert watched.began_ns - EARLY_NS <= stamp.host_ns <= watched.ended_ns


def test_no_data_is_never_a_number(watched: Watched) -> None:
    """Samples are of their kind; arrays keep their shape; NaN stands for what was not received."""
    kind = kinds()[watched.kind]
    names = arrays_of(kind.sample)
    assert all(type(s) is kind.sample for s in watched.samples)
    for name in names:
        forms = {(getattr(s, name).shape, getattr(s, name).dtype) for s in watched.samples}
        assert len(forms) <= 1, f"{name} changes its shape or type: {forms}"
        assert all(dtype in DTYPES.values() for _, dtype in forms), f"{name} is recorded as another type"
    for sample in watched.samples:
        states = sample.status if isinstance(sample.status, tuple) else (sample.status,)
        assert len(states) == max(1, len(kind.labels))
        for name in names:
            for values, said in by_channel(getattr(sample, name), states):
                assert any(s is not Status.OK for s in said) or np.all(np.isfinite(values)), name
                assert any(s not in NOTHING for s in said) or np.all(np.isnan(values)), name


def test_a_sample_is_delivered_once(watched: Watched) -> None:
    """No two have the same time and number."""
    keys = [(s.stamp.t_ns, s.stamp.seq) for s in watched.samples]
    assert len(set(keys)) == len(keys)


def test_a_read_never_waits_for_the_next_sample(device: Any, closed_bench: Bench, collect: Collect) -> None:
    """It takes what is there; two of twenty reads may be late because this computer was busy elsewhere."""
    collect(device, SHORT_S)
    took_ns = []
    for _ in range(20):
        began_ns = closed_bench.clock.now_ns()
        device.read()
        took_ns.append(closed_bench.clock.now_ns() - began_ns)
        closed_bench.clock.sleep_until_ns(began_ns + 10_000_000)
    assert sorted(took_ns)[-3] < LONGEST_READ_NS


def test_samples_are_recorded_bit_for_bit(watched: Watched) -> None:
    """A recording gives back what was written; each topic has a message of every sample."""
    kind = kinds()[watched.kind]
    own = () if kind.name in OURS else (kind,)
    samples = tuple(watched.samples)
    delivered: dict[str, Any] = {"added": {kind.name: samples}} if own else {kind.name: samples}
    inputs = Inputs(0, 0, **delivered)
    record = _record_of(inputs)
    again = CycleDecoder(describe(own)).decode(CycleEncoder(own).encode(record))
    assert first_difference({"inputs": inputs}, {"inputs": again.inputs}) is None
    for topic in kind.topics:
        assert all(len(topic.encode(sample, 0)) > 4 for sample in samples), topic.name


def _record_of(inputs: Inputs) -> CycleRecord:
    """A cycle in which nothing was decided."""
    rest = WheelSetpoint(np.zeros(4), np.zeros(4))
    state = RobotState(0, np.zeros(3), np.zeros(3), np.zeros((6, 6)))
    command = ServoSetpoint(np.zeros(4), np.zeros(4))
    return CycleRecord(0, 0, 0, inputs, Measurements(0, 0), state, None, rest, command)


def test_the_same_seed_gives_the_same_samples(
    backend: str, kind: str, request: pytest.FixtureRequest
) -> None:
    """The emulated device takes chance from the world's seed and from nowhere else."""
    if not backend.startswith(VIRTUAL):
        pytest.skip("in virtual time only")

    def samples() -> list[Any]:
        bench = opened(backend, request)
        bench.begin()
        try:
            device = bench.rig.get(kind)
            device.open()
            return read_for(bench, device, SHORT_S)
        finally:
            bench.close()

    assert first_difference({"samples": tuple(samples())}, {"samples": tuple(samples())}) is None


@pytest.fixture(scope="module")
def findings(backend: str, request: pytest.FixtureRequest) -> list[Finding]:
    """What the doctor says of the bench; at the wire this computer's load would be among it."""
    if backend.startswith(WIRE):
        pytest.skip("in virtual time and on hardware only")
    return list(examine(opened(backend, request), watch_s=SHORT_S))


def test_the_doctor_finds_no_failure(findings: list[Finding], kind: str) -> None:
    """A healthy device passes what `hil doctor` asks of it."""
    own = [f for f in findings if f.device == kind]
    assert own, f"the doctor says nothing of {kind}"
    assert not [f for f in own if f.level == "failure"]
