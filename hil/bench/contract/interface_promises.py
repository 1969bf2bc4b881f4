"""Contract checks of a device while nothing is commanded: identity, reopening, stamps, missing data."""

import typing
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from hil.bench.contract.device_under_test import SHARE, SHORT_S, WATCH_S, Broken, Subject, due, read_for
from hil.bench.contract.losses import loses_next_to_nothing
from hil.bench.contract.pose_at_rest import sees_no_motion
from hil.bench.third_party.sample_contract import EARLY_NS, OLDEST_NS
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DeviceError
from hil.core.geometry import Array
from hil.core.nonfinite import unmarked_nonfinite_fields
from hil.core.registry import kinds
from hil.core.signals import KINDS as OURS
from hil.core.signals import (
    CycleRecord,
    Inputs,
    Measurements,
    RobotState,
    ServoSetpoint,
    Status,
    WheelSetpoint,
    worst,
)
from hil.drivers.doctor_watch import MORE_FAILURE, surplus
from hil.recording.cycle_codec import DTYPES, CycleCodec
from hil.recording.record_comparison import first_difference

LONGEST_READ_NS = nanoseconds(0.06)
NOTHING = (Status.TIMEOUT, Status.CRC, Status.PARITY, Status.PROTOCOL)
"""Statuses of samples without any data."""
_READS, _STEP_NS = 20, nanoseconds(0.01)
_DRIVER = "fix the driver of this device"
_LINK = "check cable, supply and baud rate; `hil doctor` says more"


def says_what_it_is(subject: Subject) -> str:
    """`identity` has texts while the device is open and is empty when closed; closing twice is allowed."""
    with subject.opened() as device:
        identity = device.identity()
        texts = all(isinstance(k, str) and isinstance(v, str) and v for k, v in identity.items())
        if not identity or not texts:
            raise Broken(f"identity {dict(identity)}", "text by text: model, firmware, port", _DRIVER)
        device.close()
        if device.identity():
            raise Broken("has an identity while closed", "nothing", _DRIVER)
    return ", ".join(f"{key} {value}" for key, value in identity.items())


def opens_again(subject: Subject) -> str:
    """A closed device can be opened again, and delivers samples as before."""
    counts = []
    for _ in range(2):
        with subject.opened() as device:
            counts.append(len(read_for(subject.bench, device, SHORT_S)))
    if not all(counts):
        raise Broken(
            f"{counts[0]} samples, after it was opened again {counts[1]}", "samples each time", _LINK
        )
    return f"{counts[0]} samples, then {counts[1]}"


def closed_is_a_named_error(subject: Subject) -> str:
    """Reading a closed device raises a `DeviceError` that names the device."""
    device = subject.device
    device.close()
    try:
        device.read()
    except DeviceError as error:
        if device.name in str(error):
            return "named"
        raise Broken(f"{error}", f"an error that names {device.name}", _DRIVER) from None
    raise Broken("a closed device was read", "a DeviceError", _DRIVER)


def samples_in_time(subject: Subject) -> str:
    """Nearly all due samples arrive, are good and in order, and have a time of measurement."""
    watched = subject.watched
    expected = due(subject.bench, subject.kind, watched.samples, WATCH_S)
    wanted = SHARE * expected
    good = [s for s in watched.samples if worst(s) is Status.OK]
    if len(good) < max(2.0, wanted):
        raise Broken(f"{len(good)} good samples in {WATCH_S:g} s", f"{max(2.0, wanted):.0f} or more", _LINK)
    if surplus(len(watched.samples), expected) > MORE_FAILURE:
        found = f"{len(watched.samples)} samples in {WATCH_S:g} s"
        raise Broken(found, f"about {expected:.0f}: no more than its rate allows", _DRIVER)
    if np.any(np.diff([s.stamp.t_ns for s in good]) <= 0):
        raise Broken("times of measurement go back", "each later than the one before", _DRIVER)
    if np.any(np.diff([s.stamp.seq for s in watched.samples]) < 0):
        raise Broken("sequence numbers go back", "none lower than the one before", _DRIVER)
    for stamp in (s.stamp for s in good):
        if not watched.began_ns - OLDEST_NS <= stamp.t_ns <= stamp.host_ns + EARLY_NS:
            age_s = (stamp.host_ns - stamp.t_ns) / NS_PER_S
            allowed = f"0 to {OLDEST_NS / NS_PER_S:g} s before it arrived"
            raise Broken(f"a sample measured {age_s:.3g} s before it arrived", allowed, _LINK)
        if not watched.began_ns - EARLY_NS <= stamp.host_ns <= watched.ended_ns:
            raise Broken(
                "a sample arrived before or after it was read", "arrival by the bench clock", _DRIVER
            )
    return f"{len(good)} of {len(watched.samples)} good in {WATCH_S:g} s"


def no_data_is_no_number(subject: Subject) -> str:
    """Samples have the type of their kind; arrays keep their shape; missing data are NaN."""
    kind, samples = kinds()[subject.kind], subject.watched.samples
    names, missing = arrays_of(kind.sample), subject.not_measured
    if not all(type(s) is kind.sample for s in samples):
        raise Broken("samples of another type", kind.sample.__name__, _DRIVER)
    for name in names:
        forms = {(getattr(s, name).shape, getattr(s, name).dtype) for s in samples}
        if len(forms) > 1 or not all(dtype in DTYPES for _, dtype in forms):
            raise Broken(
                f"{name} has shapes and types {forms}", "one shape, and a type that is recorded", _DRIVER
            )
    for sample in samples:
        states = sample.status if isinstance(sample.status, tuple) else (sample.status,)
        if len(states) != max(1, len(kind.labels)):
            raise Broken(f"{len(states)} statuses", f"{max(1, len(kind.labels))}", _DRIVER)
        for name in unmarked_nonfinite_fields(kind, sample, missing):
            raise Broken(f"{name} is NaN or infinite with status ok", "a number", _DRIVER)
        for name in set(names) - set(missing):
            for values, said in by_channel(getattr(sample, name), states):
                if all(s in NOTHING for s in said) and not np.all(np.isnan(values)):
                    raise Broken(f"{name} has numbers with status {said[0].value}", "NaN", _DRIVER)
    return f"{len(samples)} samples"


def delivered_once(subject: Subject) -> str:
    """No two samples have the same stamp and sequence number."""
    keys = [(s.stamp.t_ns, s.stamp.seq) for s in subject.watched.samples]
    if len(set(keys)) != len(keys):
        raise Broken(f"{len(keys) - len(set(keys))} of {len(keys)} samples came twice", "each once", _DRIVER)
    return "each once"


def reads_do_not_wait(subject: Subject) -> str:
    """A read returns available samples without waiting; two of twenty may be late on a busy computer."""
    clock, took_ns = subject.bench.clock, []
    with subject.opened() as device:
        read_for(subject.bench, device, SHORT_S)
        for _ in range(_READS):
            began_ns = clock.now_ns()
            device.read()
            took_ns.append(clock.now_ns() - began_ns)
            clock.sleep_until_ns(began_ns + _STEP_NS)
    usual_ns = sorted(took_ns)[-3]
    message = f"{1e-6 * usual_ns:.2g} ms"
    if usual_ns >= LONGEST_READ_NS:
        raise Broken(f"reads take {message}", f"less than {1e-6 * LONGEST_READ_NS:g} ms", _LINK)
    return message


def recorded_bit_for_bit(subject: Subject) -> str:
    """A recording returns the written samples bit for bit, and what a topic makes of them is of its type."""
    kind, samples = kinds()[subject.kind], tuple(subject.watched.samples)
    own = () if kind.name in OURS else (kind,)
    delivered: dict[str, Any] = {"added": {kind.name: samples}} if own else {kind.name: samples}
    inputs = Inputs(0, 0, **delivered)
    codec = CycleCodec(own)
    again = codec.decode(codec.encode(_record_of(inputs)))
    difference = first_difference({"inputs": inputs}, {"inputs": again.inputs})
    if difference is not None:
        raise Broken(f"recorded otherwise: {difference}", "what was written", _DRIVER)
    from hil.recording.rosbags_adapter import MessageMaker, from_cdr, to_cdr

    ros = MessageMaker()
    for topic in kind.topics:
        for sample in samples:
            made = topic.message(sample, ros)
            if made is None:  # a sample without the values that its message needs
                continue
            written = to_cdr(made)
            try:
                repeated = to_cdr(from_cdr(written, topic.type))
            except ValueError as error:
                raise Broken(f"{topic.name} has {error}", topic.type, _DRIVER) from None
            if getattr(made, "__msgtype__", topic.type) != topic.type or repeated != written:
                raise Broken(f"{topic.name} has another message", topic.type, _DRIVER)
    return f"{len(samples)} samples"


def same_seed_same_samples(subject: Subject) -> str:
    """An emulated device takes random numbers only from the world's seed."""
    anew = subject.anew
    if anew is None:
        return "in virtual time only"

    def samples() -> tuple[Any, ...]:
        bench = anew()
        bench.begin()
        try:
            with Subject(bench, subject.kind).opened() as device:
                return tuple(read_for(bench, device, SHORT_S))
        finally:
            bench.close()

    difference = first_difference({"samples": samples()}, {"samples": samples()})
    if difference is not None:
        raise Broken(f"another run differs: {difference}", "the same samples from the same seed", _DRIVER)
    return "twice the same"


def arrays_of(sample: type[Any]) -> list[str]:
    """Names of the fields of a sample that hold arrays."""
    hints = typing.get_type_hints(sample)
    return [f.name for f in fields(sample) if hints[f.name] == Array]


def by_channel(values: Array, states: tuple[Status, ...]) -> list[tuple[Array, tuple[Status, ...]]]:
    """Parts of an array (n,) or (n, m) with their statuses; one part per channel if it has one row each.

    Integers and booleans have no NaN, so they give no parts.
    """
    if values.dtype.kind != "f":
        return []
    if values.ndim and len(values) == len(states):
        return [(row, (state,)) for row, state in zip(values, states, strict=True)]
    return [(values, states)]


def _record_of(inputs: Inputs) -> CycleRecord:
    """A cycle record with these inputs and no commands."""
    rest = WheelSetpoint(np.zeros(4), np.zeros(4))
    state = RobotState(0, np.zeros(3), np.zeros(3), np.zeros((6, 6)))
    command = ServoSetpoint(np.zeros(4), np.zeros(4))
    return CycleRecord(0, 0, 0, inputs, Measurements(0, 0, added=inputs.added), state, None, rest, command)


AT_REST: Mapping[str, Callable[[Subject], str]] = {
    "identity": says_what_it_is,
    "opens again": opens_again,
    "closed is a named error": closed_is_a_named_error,
    "samples in time": samples_in_time,
    "loses next to nothing": loses_next_to_nothing,
    "sees no motion": sees_no_motion,
    "no data is no number": no_data_is_no_number,
    "delivered once": delivered_once,
    "reads do not wait": reads_do_not_wait,
    "recorded bit for bit": recorded_bit_for_bit,
    "same seed, same samples": same_seed_same_samples,
}
"""Checks by the name of the promise, as shown on a page."""
