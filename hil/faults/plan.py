"""The planned faults of a run, and which of them are active on which device at a time.

A single fault is a `hil.faults.fault.Fault`.
"""

from __future__ import annotations

from collections.abc import Container, Hashable, Iterable, Mapping

import numpy as np

from hil.core.errors import FaultNotSupportedError, UsageError, did_you_mean
from hil.core.registry import which_device
from hil.faults.fault import Fault, Option, Supported, check_kind


class FaultPlan:
    """All planned faults of a run. Each device gets a view of its own faults from `of`.

    A device may go by several names (`servos`, `servo.drive_FL`, `servo.1`).

    Attributes:
        empty: True if no fault is planned.
        touched: True if a fault is planned, or has been planned before.
    """

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._faults: list[Fault] = []
        self.touched = False
        self._views: list[DeviceFaultView] = []
        self._keep(list(faults))
        self._supported: dict[str, Supported] = {}
        self._ranges: dict[str, Mapping[str, Option]] = {}

    def of(self, *names: str) -> DeviceFaultView:
        """Return a view of the faults of a device that has these names; it follows changes of the plan."""
        view = DeviceFaultView(self, names)
        self._views.append(view)
        view.follow(fault.device for fault in self._faults)
        return view

    def declare(self, device: str, supported: Supported, ranges: Mapping[str, Option] | None = None) -> None:
        """Register a device name and the faults that the device can produce, for `check` and `add`.

        Args:
            device: its name.
            supported: faults and their options.
            ranges: options by `KIND:NAME` whose range is narrower than that of other devices.

        Raises:
            UsageError: a kind that is not in `VOCABULARY`, or options that are not identifiers.
        """
        for kind, options in supported.items():
            check_kind(f"device {device} declares the fault {kind!r}", kind)
            if isinstance(options, str) or not all(
                isinstance(key, str) and key.isidentifier() for key in options
            ):
                raise UsageError(
                    f"device {device} declares the fault {kind!r} with the options {options!r}",
                    expected="a tuple of names, such as () or ('probability',)",
                )
        self._supported[device], self._ranges[device] = dict(supported), dict(ranges or {})

    def add(self, fault: Fault) -> None:
        """Add a fault while the world runs.

        Raises:
            FaultNotSupportedError: no device can produce it.
        """
        self._check_one(fault)
        self._keep([*self._faults, fault])

    def clear(self) -> None:
        """Remove all faults."""
        self._keep([])

    def _keep(self, faults: list[Fault]) -> None:
        self._faults = faults
        self._newest_first: dict[tuple[str, str], list[Fault]] = {}
        for fault in sorted(reversed(faults), key=lambda fault: -fault.start_ns):
            self._newest_first.setdefault((fault.device, fault.kind), []).append(fault)
        self._kinds = frozenset(fault.kind for fault in faults)
        self.empty = not faults
        self.touched |= not self.empty
        for view in self._views:
            view.follow(fault.device for fault in faults)

    def check(self, among: Container[Fault] | None = None) -> None:
        """Raise `FaultNotSupportedError` for the first fault (of `among`) that no device can produce."""
        for fault in self._faults:
            if among is None or fault in among:
                self._check_one(fault)

    def _check_one(self, fault: Fault) -> None:
        if fault.device not in self._supported:
            raise FaultNotSupportedError(
                f"fault {fault.device}:{fault.kind}: no emulated device of that name",
                expected="one of " + ", ".join(sorted(self._supported)),
                remedy=which_device(fault.device, self._supported),
            )
        kinds = self._supported[fault.device]
        if fault.kind not in kinds:
            raise FaultNotSupportedError(
                f"{fault.device} cannot produce the fault {fault.kind!r}",
                expected="one of " + ", ".join(sorted(kinds)),
                remedy=did_you_mean(fault.kind, kinds),
            )
        options = kinds[fault.kind]
        for key in fault.options:
            if key not in options:
                raise FaultNotSupportedError(
                    f"fault {fault.device}:{fault.kind} has no option {key!r}",
                    expected="one of " + ", ".join(options) if options else "no option",
                    remedy=did_you_mean(key, options),
                )
            option = self._ranges[fault.device].get(f"{fault.kind}:{key}")
            if option is not None:
                fault.check(key, option)

    def has(self, kind: str) -> bool:
        """Return whether a fault of this kind is planned on any device at any time."""
        return kind in self._kinds

    @property
    def supported(self) -> Mapping[str, Supported]:
        """Supported faults of every declared device name."""
        return self._supported

    def first_ns(self, device: str) -> int:
        """Return the time at which the first fault of a device begins, ns; it must have one."""
        return min(fault.start_ns for fault in self._faults if fault.device == device)

    def find(self, device: str, kind: str, t_ns: int) -> Fault | None:
        """Return the active fault of this kind on this device that started last, or None.

        A fault that acts once (a jump, a reset) has no end unless one is given; a later one takes precedence.
        """
        for fault in self._newest_first.get((device, kind), ()):
            if fault.active(t_ns):
                return fault
        return None

    def active(self, device: str, t_ns: int) -> tuple[Fault, ...]:
        """Return all active faults of a device, in the order in which they were planned."""
        return tuple(f for f in self._faults if f.device == device and f.active(t_ns))


class DeviceFaultView:
    """View of the faults of a plan that concern one device.

    Attributes:
        empty: True if no fault is or was planned for this device, so it can skip all queries. It stays False
            after the faults have been cleared, because the device must still notice that they ended.
    """

    def __init__(self, plan: FaultPlan, names: Iterable[str]) -> None:
        self._plan, self._names = plan, frozenset(names)
        self.empty = True
        self.find, self.active, self.has = plan.find, plan.active, plan.has

    def follow(self, devices: Iterable[str]) -> None:
        """Clear `empty` if faults are planned for one of this view's names."""
        self.empty = self.empty and self._names.isdisjoint(devices)


class Once:
    """Remembers which one-time faults (a jump, a reset) have already acted."""

    def __init__(self) -> None:
        self._done: set[tuple[Hashable, int]] = set()

    def first_activation(self, of: Hashable, fault: Fault | None) -> Fault | None:
        """Return an active fault at its first query, and None at every later one.

        Args:
            of: label that distinguishes this fault from others that start at the same time.
            fault: the active fault, or None.
        """
        if fault is None or (of, fault.start_ns) in self._done:
            return None
        self._done.add((of, fault.start_ns))
        return fault


class DeviceFaults:
    """Queries the plan for the faults of a device with a single name.

    Args:
        plan: fault plan of the world.
        name: device name.
        rng: random numbers for faults with a probability.

    Attributes:
        plan: view of this device's faults. `plan.empty` equals `none` and is cheaper to read in every step.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        self.plan, self._name, self._rng = plan.of(name), name, rng
        self._once = Once()
        self._off = False

    @property
    def none(self) -> bool:
        """Whether no fault is planned for the device, nor has been."""
        return self.plan.empty

    def find(self, kind: str, t_ns: int) -> Fault | None:
        """Return the active fault of this kind, or None."""
        return None if self.plan.empty else self.plan.find(self._name, kind, t_ns)

    def first_activation(self, kind: str, t_ns: int) -> Fault | None:
        """Return the active one-time fault of this kind at its first query, None at every later one."""
        return self._once.first_activation(kind, self.find(kind, t_ns))

    def restarted(self, t_ns: int) -> bool:
        """Return whether the device has just restarted after `reset` or `off`; call it at every step."""
        was_off, self._off = self._off, self.find("off", t_ns) is not None
        return self.first_activation("reset", t_ns) is not None or (was_off and not self._off)

    def period_factor(self, t_ns: int) -> float:
        """Return the factor by which a `slow` fault stretches the output period; 1 without one."""
        fault = self.find("slow", t_ns)
        return 1.0 if fault is None else fault.period_factor

    def lateness_ns(self, t_ns: int) -> int:
        """Return the extra latency of the device's output under a `delayed` fault, ns."""
        fault = self.find("delayed", t_ns)
        return 0 if fault is None else fault.delay_ns()
