"""All faults of a run: which is active on which emulated device, when. One of them is `hil.fakes.fault`."""

from __future__ import annotations

from collections.abc import Container, Hashable, Iterable, Mapping

import numpy as np

from hil.core.errors import FaultNotSupportedError, UsageError, did_you_mean
from hil.core.registry import which_device
from hil.fakes.fault import Fault, Supported, check_kind


class FaultPlan:
    """All faults of a run. Devices ask with their own names, for what concerns them: see `of`.

    A device may go by several names (`servos`, `servo.drive_FL`, `servo.1`).

    Attributes:
        empty: there is nothing to ask for.
        touched: there is something to ask for, or has been.
    """

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._faults: list[Fault] = []
        self.touched = False
        self._views: list[FaultsOf] = []
        self._keep(list(faults))
        self._supported: dict[str, Supported] = {}

    def of(self, *names: str) -> FaultsOf:
        """What concerns a device of these names, from now on."""
        view = FaultsOf(self, names)
        self._views.append(view)
        view.follow(fault.device for fault in self._faults)
        return view

    def declare(self, device: str, supported: Supported) -> None:
        """A device announces a name and what it can do; checks the faults known so far at `check`.

        Raises:
            UsageError: a kind that is not in `VOCABULARY`, or options that are no names.
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
        self._supported[device] = dict(supported)

    def add(self, fault: Fault) -> None:
        """Add a fault while running; refused at once when unsupported."""
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

    def check(self) -> None:
        """Raise `FaultNotSupportedError` for the first fault that no device can produce."""
        for fault in self._faults:
            self._check_one(fault)

    def _check_one(self, fault: Fault) -> None:
        if fault.device not in self._supported:
            raise FaultNotSupportedError(
                f"fault {fault.device}:{fault.kind}: no emulated device of that name",
                expected="one of " + ", ".join(sorted(self._supported)),
                remedy=which_device(fault.device, self._supported) or "faults are refused on real hardware",
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

    def has(self, kind: str) -> bool:
        """Whether a fault of that kind is planned on any device at any time."""
        return kind in self._kinds

    @property
    def supported(self) -> Mapping[str, Supported]:
        """What every name that devices announced can produce."""
        return self._supported

    def find(self, device: str, kind: str, t_ns: int) -> Fault | None:
        """The active fault of that kind on that device that began last, or None.

        One that acts once (a jump, a reset) is active for ever; it does not hide those that come later.
        """
        for fault in self._newest_first.get((device, kind), ()):
            if fault.active(t_ns):
                return fault
        return None

    def active(self, device: str, t_ns: int) -> tuple[Fault, ...]:
        """All faults active on a device, in the order given."""
        return tuple(f for f in self._faults if f.device == device and f.active(t_ns))

    def acting(self, devices: Container[str], t_ns: int) -> bool:
        """Whether any fault acts on any of these devices."""
        return any(f.device in devices and f.active(t_ns) for f in self._faults)


class FaultsOf:
    """The faults of a plan that concern one device.

    Attributes:
        empty: none is planned for it, and none has been: lets it skip the query, whatever happens to others.
            A device whose faults have been cleared goes on asking, for it has to find its way back.
    """

    def __init__(self, plan: FaultPlan, names: Iterable[str]) -> None:
        self._plan, self._names = plan, frozenset(names)
        self.empty = True
        self.find, self.active, self.has = plan.find, plan.active, plan.has

    def follow(self, devices: Iterable[str]) -> None:
        """Faults of these devices are planned now."""
        self.empty = self.empty and self._names.isdisjoint(devices)

    def acting(self, t_ns: int) -> bool:
        """Whether any of them acts now."""
        return not self.empty and self._plan.acting(self._names, t_ns)


class Once:
    """Remembers which faults have acted that act once: a jump, a reset."""

    def __init__(self) -> None:
        self._done: set[tuple[Hashable, int]] = set()

    def news(self, of: Hashable, fault: Fault | None) -> Fault | None:
        """The fault, if there is one and it has not been asked about before.

        Args:
            of: distinguishes it from others that begin at the same time.
            fault: active now.
        """
        if fault is None or (of, fault.start_ns) in self._done:
            return None
        self._done.add((of, fault.start_ns))
        return fault


class DeviceFaults:
    """Asks the plan what is wrong now with a device that goes by one name.

    Args:
        plan: of the world.
        name: of the device.
        rng: for faults that strike at random.

    Attributes:
        plan: what concerns it; a caller in every step reads `plan.empty` itself, which is `none`.
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
        """The active fault of that kind."""
        return None if self.plan.empty else self.plan.find(self._name, kind, t_ns)

    def news(self, kind: str, t_ns: int) -> Fault | None:
        """A fault that acts once and has not been asked about before."""
        return self._once.news(kind, self.find(kind, t_ns))

    def restarted(self, t_ns: int) -> bool:
        """Whether it has just come back from a reset or from being off; to be asked all the time."""
        was_off, self._off = self._off, self.find("off", t_ns) is not None
        return self.news("reset", t_ns) is not None or (was_off and not self._off)

    def slowness(self, t_ns: int) -> float:
        """Factor on the period of output."""
        fault = self.find("slow", t_ns)
        return 1.0 if fault is None else fault.slowness

    def lateness_ns(self, t_ns: int) -> int:
        """By how much later what the device says is heard."""
        fault = self.find("delayed", t_ns)
        return 0 if fault is None else fault.delay_ns()

    def damaged(self, packet: bytes, t_ns: int) -> tuple[bytes, ...]:
        """A datagram as it arrives: with a wrong byte, cut off, twice, or whole."""
        if self._hit("corrupt", t_ns):
            damaged = bytearray(packet)
            damaged[int(self._rng.integers(0, len(packet)))] ^= int(self._rng.integers(1, 256))
            packet = bytes(damaged)
        if self._hit("truncate", t_ns):
            packet = packet[: int(self._rng.integers(0, len(packet)))]
        return (packet, packet) if self._hit("duplicate", t_ns) else (packet,)

    def _hit(self, kind: str, t_ns: int) -> bool:
        fault = self.find(kind, t_ns)
        return fault is not None and fault.strikes(self._rng)
