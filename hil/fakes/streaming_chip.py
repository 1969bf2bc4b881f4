"""Base classes of chips that send without requests: period, power supply and common faults."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from hil.core.clock import NS_PER_S, nanoseconds
from hil.fakes.can_channel import CanChannel
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.world import NEVER_NS, Scheduled
from hil.faults.fault import Fault, Supported
from hil.faults.plan import DeviceFaults

COMMON_FAULTS: Supported = {
    "off": (),
    "brownout": (),
    "reset": (),
    "stuck": (),
    "slow": ("factor",),
    "delayed": ("delay_s",),
}
"""Faults that the base classes implement for every such chip; serial line and CAN bus add theirs."""


class StreamingChip:
    """Base of `SerialStreamingChip` and `CanStreamingNode`; a subclass defines `measure` and `encode`.

    Args:
        request: world, table of the bench file, `[emulation.KIND]`.

    Attributes:
        Options: frozen dataclass of the true imperfections, `[emulation.KIND]`.
        own_faults: faults beside the common ones, and the options that each takes; query them with `fault`.
        boot_s: silence after its supply comes back.
        delay_s: time from measurement to sending.
        world: plant, clock, faults and random streams.
        config: its table of the bench file.
        options: an instance of `Options`.
        rng: random numbers of the chip.
        faults: faults planned for the chip.
        rate_hz: measurements per second; 0 for none without requests.
    """

    Options: ClassVar[Any]
    own_faults: ClassVar[Supported] = {}
    boot_s: ClassVar[float] = 0.3
    delay_s: ClassVar[float] = 0.0

    def __init__(self, request: EmulationRequest) -> None:
        self.name, self.world, self.config = request.kind, request.world, request.config
        self.options: Any = request.options(type(self).Options)
        self.rng = self.world.rng(self.name)
        self.faults = DeviceFaults(self.world.faults, self.name, self.rng)
        self.rate_hz: float = self.config.rate_hz
        self._due_ns = self.world.now_ns + self._period_ns()
        self._ready_ns = 0
        self._frozen: Any = None
        self._was_off = False

    @abstractmethod
    def measure(self, t_ns: int) -> Any:
        """Make one measurement with all errors of the chip."""

    def restart(self, t_ns: int) -> None:
        """Reset the settings after a return of power."""
        return

    def fault(self, kind: str, t_ns: int) -> Fault | None:
        """Return the active fault of this kind, or None."""
        return self.faults.find(kind, t_ns)

    def fault_option(self, kind: str, option: str, default: float) -> float:
        """Option of an active fault of this kind, or `default` if not given; 0 without such a fault."""
        fault = self.fault(kind, self.world.now_ns)
        return 0.0 if fault is None else fault.option(option, default)

    def wake(self) -> None:
        """Start sending after `rate_hz` was 0."""
        self._due_ns = self.world.now_ns + self._period_ns()

    def reset(self, t_ns: int) -> None:
        """Reset everything, as a power cycle does."""
        self.restart(t_ns)
        self._ready_ns = self._due_ns = t_ns + nanoseconds(self.boot_s)

    def _period_ns(self) -> int:
        return round(NS_PER_S / self.rate_hz) if self.rate_hz else 0

    def _next(self, t_ns: int) -> Any:
        """Return the present measurement with its faults, or None if nothing is sent."""
        off = any(self.fault(kind, t_ns) is not None for kind in ("off", "brownout"))
        was_off, self._was_off = self._was_off, off
        if (was_off and not off) or self.faults.first_activation("reset", t_ns) is not None:
            self.reset(t_ns)
        self._due_ns = t_ns + round(self._period_ns() * self.faults.period_factor(t_ns))
        return None if self._is_down(t_ns) else self._shown(t_ns)

    def _shown(self, t_ns: int) -> Any:
        measured = self.measure(t_ns)
        stuck = self.fault("stuck", t_ns) is not None
        self._frozen = (self._frozen or measured) if stuck else None
        return self._frozen or measured

    def _delay_ns(self, t_ns: int) -> int:
        return nanoseconds(self.delay_s) + self.faults.lateness_ns(t_ns)

    def _is_down(self, t_ns: int) -> bool:
        return t_ns < self._ready_ns or self._was_off


class SerialStreamingChip(StreamingChip, SerialChip):
    """A chip at the far end of a serial line; define `measure`, `encode`, and `answer` if it has requests.

    If client and chip have different baud rates, both receive noise.
    """

    def __init__(self, request: EmulationRequest) -> None:
        super().__init__(request)
        self.uart_baud: int | None = self.config.baud
        self.supported_faults = {**COMMON_FAULTS, **self.own_faults}

    @classmethod
    def build(cls, request: EmulationRequest) -> SerialStreamingChip:
        """Make the chip from its table of the bench file."""
        return cls(request)

    @abstractmethod
    def encode(self, measured: Any) -> bytes:
        """Encode a measurement as bytes."""

    def answer(self, data: bytes, t_ns: int) -> bytes:
        """Reply to received bytes, in any pieces; none by default."""
        return b""

    def next_poll_ns(self) -> int:
        """Time of the next measurement."""
        return self._due_ns if self.rate_hz else NEVER_NS

    def poll(self, t_ns: int) -> list[Reply]:
        """Send one measurement, if powered."""
        measured = self._next(t_ns)
        return [] if measured is None else self._reply(measured, t_ns)

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Pass received bytes to `answer`; no reply while booting or without power.

        Raises:
            TypeError: `answer` has not returned bytes.
        """
        answer = b"" if self._is_down(t_ns) else self.answer(data, t_ns)
        if not isinstance(answer, bytes):
            raise TypeError(f"answer() gave {answer!r:.60}, expected bytes")
        return [Reply(t_ns + nanoseconds(0.001), answer)] if answer else []

    def _reply(self, measured: Any, t_ns: int) -> list[Reply]:
        data = self.encode(measured)
        if not isinstance(data, bytes):
            raise TypeError(f"encode() gave {data!r:.60}, expected bytes")
        return [Reply(t_ns + self._delay_ns(t_ns), data)]


class CanStreamingNode(StreamingChip, Scheduled):
    """A node on a CAN bus that sends the frames of its table's `FRAME_IDS`; define `measure` and `encode`."""

    announces = True

    def __init__(self, request: EmulationRequest, channel: CanChannel) -> None:
        super().__init__(request)
        self._channel = channel
        channel.declare(self.name, {**COMMON_FAULTS, **self.own_faults})
        self.world.add(self)

    @classmethod
    def build(cls, request: EmulationRequest, channel: CanChannel) -> CanStreamingNode:
        """Make the node from its table of the bench file."""
        return cls(request, channel)

    @abstractmethod
    def encode(self, measured: Any) -> Mapping[int, bytes]:
        """Encode a measurement as frames, by identifier."""

    def next_due_ns(self) -> int:
        """Time of the next measurement."""
        return self._due_ns if self.rate_hz else NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Send one measurement, if powered."""
        measured = self._next(t_ns)
        if measured is None:
            return
        sent_ns = t_ns + self._delay_ns(t_ns)
        for frame_id, data in self.encode(measured).items():
            self._channel.transmit(frame_id, data, sent_ns, extended=frame_id > 0x7FF)
