"""Checks that each declared fault of an emulated device changes what its driver or its robot shows.

A fault without effect is worse than none: tests that use it pass without testing anything. Each run uses a
new bench with the same seed, and moves wheels and steering if there are any; its results are compared with
those of the same run without a fault.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from hil.bench.bench import Bench
from hil.bench.contract.device_under_test import Broken, Subject
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import HilError
from hil.core.registry import kinds
from hil.core.signals import ServoSetpoint
from hil.faults.fault import parse_fault

_WATCH_S, _AT_S = 1.5, 0.5
_SWING_RAD, _RATE_RAD_S, _PERIOD_S = 0.2, 1.0, 1.0

Samples = tuple[Any, ...]


def each_fault_acts(subject: Subject) -> str:
    """Inject each fault of the device in turn. Raises `Broken` for faults that change nothing."""
    assert subject.anew is not None
    healthy, kind = _seen(subject.anew, subject.kind, ""), subject.kind
    declared = _declared(subject)
    if _seen(subject.anew, kind, "") != healthy:
        raise Broken(f"two runs of {kind} without a fault differ", "the same seed to give the same run")
    idle = [fault for fault in declared if _seen(subject.anew, kind, fault) == healthy]
    if idle:
        raise Broken(
            f"{kind} declares {', '.join(idle)}, and nothing changes by it",
            "another sample or motion",
            "model the fault in the emulated device, or do not declare it",
        )
    return f"{len(declared)} faults change something"


def _declared(subject: Subject) -> tuple[str, ...]:
    world = subject.bench.world
    found = () if world is None else world.faults.supported.get(subject.kind, ())
    borne = (*_BORNE, *getattr(subject.bench.devices.get(subject.kind), "bears", ()))
    return tuple(fault for fault in found if fault not in borne)


def _seen(anew: Callable[[], Bench], kind: str, fault: str) -> Samples:
    """Run a bench with one fault, and return samples, errors and the motion of the robot for comparison."""
    bench = anew()
    world = bench.world
    assert world is not None
    reported: list[Any] = []
    try:
        bench.begin()
        began_ns = bench.clock.now_ns()
        if fault:
            at_s = began_ns / NS_PER_S + _AT_S
            world.faults.add(parse_fault(f"{kind}:{fault}@{at_s:.3f}{_SURELY.get(fault, '')}"))
        reported += _watched(bench, kind)
        reported.append(_text_of(bench.truth()))
        reported.append(world.plant.adhesion_n())
    finally:
        bench.close()
    return tuple(reported)


_SURELY = {
    **{kind: ",probability=1" for kind in ("drop", "corrupt", "truncate")},
    "pieces": ",size=1,gap_s=0.01",
}
_BORNE = ("duplicate",)
"""Faults that a sound driver bears unseen; those that a driver bears besides are its attribute `bears`."""


def _watched(bench: Bench, kind: str) -> Iterator[Any]:
    device, servos = bench.devices.get(kind), bench.devices.servos
    opened: list[Any] = []
    try:
        for one in dict.fromkeys((device, servos)):
            if one is not None:
                one.open()
                opened.append(one)
        if servos is not None:
            servos.enable()
        yield from map(_text_of, _driven(bench, device, servos, holds=kinds()[kind].holds_robot))
        yield {k: v for k, v in vars(device).items() if type(v) is int and not k.startswith("_")}
    except HilError as error:
        yield str(error)
    finally:
        for one in reversed(opened):
            one.close()


def _driven(bench: Bench, device: Any, servos: Any, *, holds: bool) -> Iterator[Any]:
    period_ns = nanoseconds(1.0 / bench.config.loop.rate_hz)
    begin_ns = next_ns = bench.clock.now_ns()
    while next_ns < begin_ns + nanoseconds(_WATCH_S):
        wave = math.sin(2.0 * math.pi * (next_ns - begin_ns) / NS_PER_S / _PERIOD_S)
        if servos is not None:
            servos.command(ServoSetpoint(np.full(4, _RATE_RAD_S * wave), np.full(4, _SWING_RAD * wave)))
        if holds:
            device.set_duty(0.5 + 0.1 * wave)
        yield from device.read()
        if servos is not None and servos is not device:
            servos.read()
        next_ns += period_ns
        bench.clock.sleep_until_ns(next_ns)


def _text_of(value: Any) -> str:
    """A sample as text for exact comparison: NaN equals NaN, arrays are compared bit for bit."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if is_dataclass(value):
        own = (f"{field.name}={_text_of(getattr(value, field.name))}" for field in fields(value))
        return f"{type(value).__name__}({', '.join(own)})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_text_of, value))})"
    return repr(value)
