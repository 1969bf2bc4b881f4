"""A ready-made test module: the device contract, on emulated and real devices.

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

from collections.abc import Callable, Generator
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from hil.bench import Bench
from hil.bench.contract import Subject, at_rest, read_for
from hil.bench.contract.faulted import each_fault_acts
from hil.bench.contract.losses import loses_next_to_nothing
from hil.bench.contract.stillness import sees_no_motion
from hil.bench.doctor.examination import examine
from hil.core.errors import DeviceError
from hil.core.finding import Finding
from hil.core.registry import base_of
from hil.procedure.bench_request import BenchSource
from hil.pytest_plugin.bench_selection import plainly, source_of

__all__ = [
    "closed_bench",
    "collect",
    "device",
    "findings",
    "pytest_generate_tests",
    "subject",
    "test_a_read_never_waits_for_the_next_sample",
    "test_a_robot_at_rest_is_seen_to_stand",
    "test_a_sample_is_delivered_once",
    "test_an_open_device_says_what_it_is_and_a_closed_one_says_nothing",
    "test_each_declared_fault_changes_something",
    "test_it_can_be_opened_again",
    "test_it_loses_next_to_nothing",
    "test_no_data_is_never_a_number",
    "test_reading_a_closed_device_is_a_named_error",
    "test_samples_are_recorded_bit_for_bit",
    "test_samples_arrive_in_order_with_stamps_that_make_sense",
    "test_the_doctor_finds_no_failure",
    "test_the_same_seed_gives_the_same_samples",
]

VIRTUAL, WIRE, GIVEN = "virtual", "wire", "given"
SHORT_S = 0.2

Collect = Callable[[Any, float], list[Any]]


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
    asked = [(way, kind) for way in ways for kind in present if {kind, base_of(kind)} & {*wanted}]
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
def subject(closed_bench: Bench, backend: str, kind: str, request: pytest.FixtureRequest) -> Subject:
    """One closed device after the other; what it delivers while it is watched is kept for all tests."""
    virtual = backend.startswith(VIRTUAL)
    return Subject(closed_bench, kind, (lambda: opened(backend, request)) if virtual else None)


def test_an_open_device_says_what_it_is_and_a_closed_one_says_nothing(subject: Subject) -> None:
    """Identity is text by text; closing twice is allowed."""
    at_rest.says_what_it_is(subject)


def test_it_can_be_opened_again(subject: Subject) -> None:
    """After it was closed, and without being asked to, it delivers as before."""
    at_rest.opens_again(subject)


def test_reading_a_closed_device_is_a_named_error(subject: Subject) -> None:
    """A `DeviceError` with the device's name."""
    at_rest.closed_is_a_named_error(subject)


def test_samples_arrive_in_order_with_stamps_that_make_sense(subject: Subject) -> None:
    """Nearly all samples that are due come, are good, and say when they were measured."""
    at_rest.samples_in_time(subject)


def test_it_loses_next_to_nothing(subject: Subject) -> None:
    """As many of the samples that are due are good as `bring_up` asks for, and it does not start over."""
    loses_next_to_nothing(subject)


def test_a_robot_at_rest_is_seen_to_stand(subject: Subject) -> None:
    """The reported position drifts by less than 5 mm/s; devices without a position pass."""
    sees_no_motion(subject)


def test_no_data_is_never_a_number(subject: Subject) -> None:
    """Samples are of their kind; arrays keep their shape; NaN stands for what was not received."""
    at_rest.no_data_is_no_number(subject)


def test_a_sample_is_delivered_once(subject: Subject) -> None:
    """No two have the same time and number."""
    at_rest.delivered_once(subject)


def test_a_read_never_waits_for_the_next_sample(subject: Subject) -> None:
    """A read takes what is there; two of twenty may be late because this computer was busy."""
    at_rest.reads_do_not_wait(subject)


def test_samples_are_recorded_bit_for_bit(subject: Subject) -> None:
    """A recording gives back what was written; each topic has a message of every sample."""
    at_rest.recorded_bit_for_bit(subject)


def test_the_same_seed_gives_the_same_samples(subject: Subject) -> None:
    """The emulated device takes chance from the world's seed and from nowhere else."""
    if subject.anew is None:
        pytest.skip("in virtual time only")
    at_rest.same_seed_same_samples(subject)


def test_each_declared_fault_changes_something(subject: Subject) -> None:
    """Samples, an error, the motion of the robot: a fault that does nothing would pass every test."""
    if subject.anew is None:
        pytest.skip("in virtual time only")
    each_fault_acts(subject)


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
