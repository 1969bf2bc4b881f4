"""The emulated serial line between a client's port and a chip: pacing, USB latency, wire faults.

Bytes leave the client's adapter at the baud rate and reach the chip; its reply is paced by the same rate. The
adapter passes received bytes to the host in packets: a full one at once, the rest when its latency timer
expires (16 ms as delivered, 1 ms as it should be set). If both ends have different baud rates, each receives
noise, also when the chip itself checks the rate: `hil.fakes.imu.bno055.uart`. Everything happens in world
time; `protocol_hil.py` and `serial_pty.py` connect clients to a line.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import serial

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import UsageError
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.world import NEVER_NS, Scheduled, World
from hil.faults.fault import IN, OUT, Supported
from hil.faults.messages import STREAM_FAULTS, Messages, declared

TOLERANCE = 0.03
"""Largest relative difference of two usable baud rates: well within half a bit of ten."""
_BITS = 8
_MIDDLE = 0.5


def same_rate(one: float, other: float) -> bool:
    """Return whether a receiver at one baud rate can decode a sender at the other."""
    return abs(one - other) <= TOLERANCE * max(one, other)


def decode_at_baud(data: bytes, sent_baud: float, own_baud: float) -> bytes:
    """Return the bytes that a UART receiver decodes.

    It starts at each falling edge and samples the line in the middle of each of its own bits: a start bit,
    eight data bits, lowest first, a stop bit. A byte without stop bit is kept as received.

    Args:
        data: bytes sent without pauses; the line is idle (1) before and after.
        sent_baud: baud rate of the sender.
        own_baud: baud rate of the receiver.
    """
    levels = [level for byte in data for level in (0, *(byte >> k & 1 for k in range(_BITS)), 1)]
    step = sent_baud / own_baud
    out = bytearray()
    at, last = 0.0, 1
    while at < len(levels):
        level = levels[int(at)]
        if not (last == 1 and level == 0):
            last, at = level, float(int(at) + 1)
            continue
        bits = [_level(levels, at + step * (k + 1 + _MIDDLE)) for k in range(_BITS)]
        out.append(sum(bit << k for k, bit in enumerate(bits)))
        at += step * (_BITS + 1 + _MIDDLE)
        last = _level(levels, at)
    return bytes(out)


def _level(levels: list[int], at: float) -> int:
    return levels[int(at)] if at < len(levels) else 1


_PORT_FAULTS: Supported = {"baud_mismatch": (), "unplug": ()}

_BITS_NS = 10 * NS_PER_S
"""Duration of one byte on the wire at 1 baud."""
_BAUD_UNSAID = 115_200
_USB_PACKET = 62
_WRONG_BAUD_FACTOR = 0.5

_LINES: dict[str, SerialLine] = {}


class Unplugged(Exception):
    """The adapter is unplugged; a transport converts this to the error that its client expects."""


class SerialLine(Scheduled):
    """One chip on one USB adapter. Registers itself as a part of the world.

    Faults of the line use the chip's name: those of `hil.faults.messages`, `baud_mismatch` and `unplug`. A
    message is a write of the client, or a reply of the chip.

    Args:
        world: time, seed and faults.
        chip: the chip at the far end.
        name: name for `hil://NAME`; the chip's name by default.
        latency_s: latency timer of the adapter; 0 passes every byte on at once.
    """

    def __init__(self, world: World, chip: SerialChip, *, name: str = "", latency_s: float = 0.001) -> None:
        self.world, self.chip, self.name = world, chip, name or chip.name
        self.faults = world.faults.of(chip.name)
        self._latency_ns = nanoseconds(latency_s)
        self._messages = Messages(
            world.faults,
            (chip.name,),
            world.rng(f"line.{chip.name}"),
            STREAM_FAULTS.keys() - chip.supported_faults.keys(),
            way=OUT if chip.ways == OUT else IN,
        )
        self._out: deque[tuple[int, bytes, int]] = deque()
        self._in: deque[tuple[int, bytes]] = deque()
        self._out_free_ns = self._in_free_ns = 0
        self._baud = _BAUD_UNSAID
        self._listens_at: Callable[[], int] | None = None
        self.in_use = False
        self._polls = getattr(type(chip), "next_poll_ns", None) is not SerialChip.next_poll_ns
        self.announces = getattr(chip, "polls_alone", False)
        faults = declared(chip.supported_faults, _PORT_FAULTS, STREAM_FAULTS, chip.ways)
        world.faults.declare(chip.name, faults, chip.fault_ranges)
        world.add(self)

    def open(self) -> SerialLine:
        """Register the line as `hil://NAME`; raises `UsageError` if the name is taken."""
        if _LINES.setdefault(self.name, self) is not self:
            raise UsageError(
                f"serial line {self.name!r} exists already", remedy="close it or use another name"
            )
        if __package__ not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(__package__)
        return self

    def close(self) -> None:
        """Remove the line from the registry. Idempotent."""
        if _LINES.get(self.name) is self:
            del _LINES[self.name]

    def send(self, data: bytes, baud: int) -> None:
        """Send bytes of the client now; raises `Unplugged`."""
        now_ns, faultless = self.world.now_ns, self.faults.empty
        if not faultless:
            self.check_plugged()
        self._baud = baud
        start_ns = now_ns if now_ns > self._out_free_ns else self._out_free_ns
        for pause_ns, piece in ((0, data),) if faultless else self._heard(data, now_ns):
            start_ns += pause_ns + len(piece) * _BITS_NS // baud
            self._out.append((start_ns, piece, baud))
        self._out_free_ns = start_ns
        self.world.changed(self)

    def listen(self, baud: Callable[[], int] | None) -> None:
        """Set the function that returns the client's present baud rate; None for no client.

        It is called only for chips with a `uart_baud`, also while the client sends nothing.
        """
        self._listens_at = baud

    def take(self, limit: int) -> bytes:
        """Take up to `limit` bytes that have reached the host."""
        arrived, now_ns, out = self._in, self.world.now_ns, b""
        while arrived and arrived[0][0] <= now_ns and len(out) < limit:
            host_ns, data = arrived.popleft()
            out += data
            if len(out) > limit:
                arrived.appendleft((host_ns, out[limit:]))
                return out[:limit]
        return out

    def waiting(self) -> int:
        """Number of bytes that have reached the host."""
        return sum(len(data) for host_ns, data in self._in if host_ns <= self.world.now_ns)

    def discard(self) -> None:
        """Discard the bytes that have reached the host."""
        while self._in and self._in[0][0] <= self.world.now_ns:
            self._in.popleft()

    def sent_ns(self) -> int:
        """Time at which the last written byte is sent."""
        return self._out_free_ns

    def next_arrival_ns(self) -> int:
        """Time at which the next bytes reach the host, as far as known."""
        return self._in[0][0] if self._in else NEVER_NS

    def next_event_ns(self, wanted: int) -> int:
        """Time at which `wanted` bytes have reached the host, or else the next action of the chip.

        Bytes arrive in sequence, so the caller need not wait for each of them.
        """
        ready_ns = self.world.now_ns
        for host_ns, data in self._in:
            if host_ns > ready_ns:
                ready_ns = host_ns
            wanted -= len(data)
            if wanted <= 0:
                return ready_ns
        return self.next_due_ns()

    def next_due_ns(self) -> int:
        """Time of the next bytes at the chip or of its next poll; never once the chip has failed."""
        if self.broken:
            return NEVER_NS
        poll_ns, out = self.chip.next_poll_ns() if self._polls else NEVER_NS, self._out
        return out[0][0] if out and out[0][0] < poll_ns else poll_ns

    def on_due(self, t_ns: int) -> None:
        """Pass arrived bytes to the chip, and queue its replies."""
        while self._out and self._out[0][0] <= t_ns:
            _, data, baud = self._out.popleft()
            rate = self._chip_baud(baud, t_ns)
            known = data if same_rate(rate, baud) else decode_at_baud(data, baud, rate)
            replies = self.chip.receive(known, t_ns, rate)
            if replies:
                self._answer(replies, baud, t_ns)
        if self._polls and self.chip.next_poll_ns() <= t_ns:
            self._answer(self.chip.poll(t_ns), self._client_baud(), t_ns)

    def check_plugged(self) -> None:
        """Raise `Unplugged` while the adapter is unplugged."""
        if not self.faults.empty and self.faults.find(self.chip.name, "unplug", self.world.now_ns):
            raise Unplugged(f"the adapter of {self.name} is gone")

    def _client_baud(self) -> int:
        if self.chip.uart_baud is None or self._listens_at is None:
            return self._baud
        return self._listens_at()

    def _chip_baud(self, baud: int, t_ns: int) -> int:
        """Baud rate of the chip, for a client at `baud`."""
        if not self.faults.empty and self.faults.find(self.chip.name, "baud_mismatch", t_ns) is not None:
            return round(baud * _WRONG_BAUD_FACTOR)
        return baud if self.chip.uart_baud is None else self.chip.uart_baud

    def _heard(self, data: bytes, t_ns: int) -> Iterator[tuple[int, bytes]]:
        """Pieces of a client's bytes that reach the chip, each with the pause before it."""
        for message in self._messages.received(data, t_ns, OUT):
            yield from self._messages.pieces(message, t_ns, OUT)

    def _answer(self, replies: list[Reply], baud: int, t_ns: int) -> None:
        rate = self._chip_baud(baud, t_ns)
        if not same_rate(rate, baud):
            replies = [r._replace(data=decode_at_baud(r.data, rate, baud)) for r in replies]
        if self.faults.empty:
            for reply in replies:
                self._deliver(reply.data, reply.ready_ns, rate)
        elif not self.faults.find(self.chip.name, "unplug", t_ns):
            for parts in _messages(replies):
                for message in self._messages.received(b"".join(part.data for part in parts), t_ns):
                    self._deliver_parts(message, parts, rate, t_ns)

    def _deliver_parts(self, message: bytes, parts: list[Reply], rate: int, t_ns: int) -> None:
        """Queue a message that the chip has sent in these parts, as far as its bytes go."""
        for part in parts:
            ready_ns, data, message = part.ready_ns, message[: len(part.data)], message[len(part.data) :]
            for pause_ns, piece in self._messages.pieces(data, t_ns):
                self._deliver(piece, max(ready_ns, self._in_free_ns) + pause_ns, rate)

    def _deliver(self, data: bytes, start_ns: int, baud: int) -> None:
        """Queue a paced reply for the host, in packets of the adapter."""
        if start_ns < self._in_free_ns:
            start_ns = self._in_free_ns
        packet = _USB_PACKET if self._latency_ns else 1
        for first in range(0, len(data), packet):
            piece = data[first : first + packet]
            start_ns += len(piece) * _BITS_NS // baud
            latency_ns = self._latency_ns if len(piece) < packet else 0
            self._in.append((start_ns + latency_ns, piece))
        self._in_free_ns = start_ns


def _messages(replies: list[Reply]) -> list[list[Reply]]:
    """Replies grouped by message."""
    groups: list[list[Reply]] = []
    for reply in replies:
        if reply.goes_on and groups:
            groups[-1].append(reply)
        else:
            groups.append([reply])
    return groups


def find_line(name: str) -> SerialLine:
    """Return the open line with this name; raises `KeyError`."""
    return _LINES[name]


def line_names() -> tuple[str, ...]:
    """Names of the open lines."""
    return tuple(_LINES)
