"""A ready-made test module: the device contract, on emulated and real devices.

In your own project, a test module needs one line::

    from hil.pytest_plugin.contract import *

It tests each device of the bench of `--bench` or of the ini key `hil_bench`. If all devices are emulated, the
suite runs twice, in virtual time and at wire level in real time; a bench with a real device is used as it is.
No commands are sent. The importing module may select kinds of devices (`KINDS = ("imu",)`), name further
models, each of which is tested in place of the bench's own (`MODELS = (("imu", "my_imu"),)`), and set keys of
the bench file for the tests at wire level (`OVERRIDES = {"servos.reply_slack_s": 0.02}`). It may also contain
its own tests: their `bench` is the plugin's.
"""

from collections.abc import Callable, Generator
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from hil.bench import Bench
from hil.bench.contract import Subject, interface_promises, read_for
from hil.bench.contract.fault_effects import each_fault_acts
from hil.bench.contract.losses import loses_next_to_nothing
from hil.bench.contract.pose_at_rest import sees_no_motion
from hil.bench.doctor.examination import examine
from hil.core.errors import DeviceError
from hil.core.finding import Finding
from hil.core.registry import base_of
from hil.procedure.bench_source import BenchSource
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
    """Parametrise the tests by device, and by virtual or real time."""
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
    cases = [(way, kind) for way in ways for kind in present if {kind, base_of(kind)} & {*wanted}]
    if not real:
        further = getattr(module, "MODELS", ())
        cases += [(f"{way} {kind}={model}", kind) for way in ways for kind, model in further]
    metafunc.parametrize(("backend", "kind"), cases, scope="module")


def source_for(backend: str, config: pytest.Config, module: ModuleType) -> BenchSource:
    """Return the session's bench in virtual time, at wire level, or as it is; with another model if named."""
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
    """Return the bench, closed; skip if a driver needs an extra of this package that is not installed."""
    with plainly():
        try:
            return source_for(backend, request.config, request.module).open()
        except DeviceError as error:
            if "the extra" not in str(error):
                raise
            pytest.skip(str(error))


@pytest.fixture(scope="module")
def closed_bench(backend: str, request: pytest.FixtureRequest) -> Generator[Bench, None, None]:
    """A bench with a running world and closed devices."""
    found = opened(backend, request)
    found.begin()
    yield found
    found.close()


@pytest.fixture
def device(closed_bench: Bench, kind: str) -> Generator[Any, None, None]:
    """Each device in turn, opened."""
    found = closed_bench.devices.get(kind)
    found.open()
    yield found
    found.close()


@pytest.fixture(scope="module")
def collect(closed_bench: Bench) -> Collect:
    """A function that reads a device at the loop rate for some time."""
    return lambda device, duration_s: read_for(closed_bench, device, duration_s)


@pytest.fixture(scope="module")
def subject(closed_bench: Bench, backend: str, kind: str, request: pytest.FixtureRequest) -> Subject:
    """Each device in turn, closed; its recorded samples are shared by all tests."""
    virtual = backend.startswith(VIRTUAL)
    return Subject(closed_bench, kind, (lambda: opened(backend, request)) if virtual else None)


def test_an_open_device_says_what_it_is_and_a_closed_one_says_nothing(subject: Subject) -> None:
    """An open device has an identity, text by text, a closed one has none; closing twice is allowed."""
    interface_promises.says_what_it_is(subject)


def test_it_can_be_opened_again(subject: Subject) -> None:
    """After it was closed, it delivers samples as before, without further commands."""
    interface_promises.opens_again(subject)


def test_reading_a_closed_device_is_a_named_error(subject: Subject) -> None:
    """Reading a closed device raises a `DeviceError` with the device's name."""
    interface_promises.closed_is_a_named_error(subject)


def test_samples_arrive_in_order_with_stamps_that_make_sense(subject: Subject) -> None:
    """Nearly all due samples arrive, are good, and have a stamp of their measurement."""
    interface_promises.samples_in_time(subject)


def test_it_loses_next_to_nothing(subject: Subject) -> None:
    """The share of good samples among due ones meets the limit of `bring_up`; the device does not restart."""
    loses_next_to_nothing(subject)


def test_a_robot_at_rest_is_seen_to_stand(subject: Subject) -> None:
    """The reported position drifts by less than 5 mm/s; devices without a position pass."""
    sees_no_motion(subject)


def test_no_data_is_never_a_number(subject: Subject) -> None:
    """Samples have the right type; arrays keep their shape; NaN marks values that were not received."""
    interface_promises.no_data_is_no_number(subject)


def test_a_sample_is_delivered_once(subject: Subject) -> None:
    """No two samples have the same time and sequence number."""
    interface_promises.delivered_once(subject)


def test_a_read_never_waits_for_the_next_sample(subject: Subject) -> None:
    """A read returns available samples without waiting; two of twenty may be late on a busy computer."""
    interface_promises.reads_do_not_wait(subject)


def test_samples_are_recorded_bit_for_bit(subject: Subject) -> None:
    """A recording returns exactly what was written; each topic has a message for every sample."""
    interface_promises.recorded_bit_for_bit(subject)


def test_the_same_seed_gives_the_same_samples(subject: Subject) -> None:
    """An emulated device takes random numbers only from the world's seed."""
    if subject.anew is None:
        pytest.skip("in virtual time only")
    interface_promises.same_seed_same_samples(subject)


def test_each_declared_fault_changes_something(subject: Subject) -> None:
    """A fault changes samples or the robot's motion, or raises an error; else it would pass every test."""
    if subject.anew is None:
        pytest.skip("in virtual time only")
    each_fault_acts(subject)


@pytest.fixture(scope="module")
def findings(backend: str, request: pytest.FixtureRequest) -> list[Finding]:
    """Findings of the doctor; not at wire level, where they would include this computer's load."""
    if backend.startswith(WIRE):
        pytest.skip("in virtual time and on hardware only")
    return list(examine(opened(backend, request), watch_s=SHORT_S))


def test_the_doctor_finds_no_failure(findings: list[Finding], kind: str) -> None:
    """A healthy device passes the checks of `hil doctor`."""
    own = [f for f in findings if f.device == kind]
    assert own, f"the doctor says nothing of {kind}"
    assert not [f for f in own if f.level == "failure"]
