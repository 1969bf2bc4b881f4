"""The emulated CAN bus: in process in virtual time as python-can interface `hil`, or across processes.

`CanChannel` is the wire. `can.Bus(interface="hil", channel=NAME)` opens a `WorldBus` on a channel that
has been put into the registry by `CanChannel.open`; `CanFace` repeats a channel's frames in real time
on any other python-can interface, by default UDP multicast that never leaves the host.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import can

from hil.fakes.faults import STRIKES, Supported
from hil.fakes.loopback import free_udp_port
from hil.fakes.server import Face
from hil.fakes.standard_can import DEFAULT_GROUP
from hil.fakes.world import NEVER_NS, World
from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.emulated_bus import Mark, bus_name
from hil.vocabulary.errors import DeviceError, UsageError

WIRE_FAULTS: Supported = {
    "drop": STRIKES,
    "truncate": STRIKES,
    "duplicate": STRIKES,
    "bus_off": (),
    "unplug": (),
    "baud_mismatch": (),
}

_QUEUE, _ECHOES = 4096, 256
_OVERHEAD_BITS, _STUFFING = 47, 1.1

_CHANNELS: dict[str, CanChannel] = {}

Frame = tuple[int, can.Message]


class CanChannel:
    """One bus: frames queue behind each other at the bit rate and reach every listener.

    Args:
        world: time, seed and faults.
        name: channel name for `can.Bus`.
        device: device name of the wire faults.
    """

    def __init__(
        self, world: World, name: str = "hil", *, bitrate: int = 500_000, device: str = "encoders"
    ) -> None:
        self.world, self.name, self.bitrate, self._device = world, name, bitrate, device
        self._listeners: list[deque[Frame]] = []
        self._rng = world.rng(f"can.{device}")
        self._free_ns = 0
        self._told_bus_off = False

    def open(self) -> CanChannel:
        """Make the channel known to `can.Bus`; raises `UsageError` if the name is taken."""
        if _CHANNELS.setdefault(self.name, self) is not self:
            raise UsageError(
                f"CAN channel {self.name!r} exists already", remedy="close it or use another name"
            )
        return self

    def close(self) -> None:
        """Forget the channel. Idempotent."""
        if _CHANNELS.get(self.name) is self:
            del _CHANNELS[self.name]

    def listen(self) -> deque[Frame]:
        """A new queue of (arrival time, frame); the oldest frames are lost when nobody reads."""
        queue: deque[Frame] = deque(maxlen=_QUEUE)
        self._listeners.append(queue)
        return queue

    def leave(self, queue: deque[Frame]) -> None:
        """Stop filling a queue."""
        self._listeners = [q for q in self._listeners if q is not queue]

    def transmit(self, frame_id: int, data: bytes, t_ns: int) -> None:
        """Put a standard data frame on the bus, not before `t_ns`."""
        self.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=False), t_ns)

    def send(self, message: can.Message, t_ns: int, *, sender: deque[Frame] | None = None) -> None:
        """Put any frame on the bus; everybody but the sender hears it, each in an object of his own."""
        bits = (_OVERHEAD_BITS + 20 * message.is_extended_id + 8 * message.dlc) * _STUFFING
        self._free_ns = max(t_ns, self._free_ns) + round(bits * 1e9 / self.bitrate)
        copies = 1
        if not self.world.faults.empty:
            spoilt = self._spoil(message, t_ns)
            if spoilt is None:
                return
            message, copies = spoilt
        message.timestamp = self._free_ns / NS_PER_S
        heard = False
        for queue in self._listeners:
            if queue is not sender:
                for _ in range(copies):
                    queue.append((self._free_ns, deepcopy(message) if heard else message))
                    heard = True

    def check_plugged(self) -> None:
        """Raise as a CAN adapter does that has been pulled out."""
        faults = self.world.faults
        if not faults.empty and faults.find(self._device, "unplug", self.world.now_ns):
            raise can.CanOperationError("the CAN adapter is gone")

    def _spoil(self, message: can.Message, t_ns: int) -> tuple[can.Message, int] | None:
        """The frame as it arrives and how often, or None when it does not."""
        faults = {f.kind: f for f in self.world.faults.active(self._device, t_ns)}
        if "bus_off" in faults or "baud_mismatch" in faults:
            if self._told_bus_off:
                return None
            self._told_bus_off = True
            return can.Message(is_error_frame=True, dlc=8, data=bytes(8)), 1
        self._told_bus_off = False

        def hit(kind: str) -> bool:
            fault = faults.get(kind)
            return fault is not None and fault.strikes(self._rng)

        if "unplug" in faults or hit("drop"):
            return None
        if hit("truncate"):
            short = bytes(message.data[: int(self._rng.integers(0, 8))])
            message = can.Message(
                arbitration_id=message.arbitration_id, data=short, is_extended_id=message.is_extended_id
            )
        return message, 2 if hit("duplicate") else 1


class WorldBus(can.BusABC):
    """python-can bus on a `CanChannel`; waiting moves the world, and stamps are on its clock.

    Args:
        channel: name of the channel.
        can_filters: as of `can.BusABC`.
        receive_own_messages: whether what is sent here is heard here, too.
        kwargs: for other interfaces.
    """

    def __init__(
        self, channel: Any, can_filters: Any = None, *, receive_own_messages: bool = False, **kwargs: object
    ) -> None:
        found = _CHANNELS.get(str(channel))
        if found is None:
            self._is_shutdown = True
            raise can.CanInitializationError(
                f"no emulated CAN channel {channel!r}; open ones: {', '.join(_CHANNELS) or 'none'}"
            )
        self._channel = found
        self._queue = found.listen()
        self._hears_itself = receive_own_messages
        self.channel_info = f"emulated CAN channel {found.name}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel, can_filters=can_filters, **kwargs)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Next frame that has arrived; waits on world time. Raises `can.CanOperationError` if unplugged."""
        world, queue = self._channel.world, self._queue
        deadline_ns = None if timeout == 0 else _deadline_ns(world.now_ns, timeout)
        while True:
            if not world.faults.empty:
                self._channel.check_plugged()
            while queue and queue[0][0] <= world.now_ns:
                message = queue.popleft()[1]
                if self._filters is None or self._matches_filters(message):
                    return message
            if deadline_ns is None or world.now_ns >= deadline_ns:
                return None
            step_ns = min(deadline_ns, world.next_due_ns(), queue[0][0] if queue else NEVER_NS)
            if step_ns >= NEVER_NS:
                raise can.CanOperationError("nothing will ever arrive on this channel")
            world.advance_to(step_ns)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a copy of a frame to everybody else on the channel, and here if it is wanted here, too."""
        self._channel.check_plugged()
        sender = None if self._hears_itself else self._queue
        self._channel.send(deepcopy(msg), self._channel.world.now_ns, sender=sender)

    def shutdown(self) -> None:
        """Leave the channel."""
        if not self._is_shutdown:
            self._channel.leave(self._queue)
        super().shutdown()

    def __del__(self) -> None:
        """It holds nothing that outlives it: the keeper of an emulated fan goes with its world."""

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        return [{"interface": "hil", "channel": name} for name in _CHANNELS]


def _deadline_ns(now_ns: int, timeout_s: float | None) -> int:
    return NEVER_NS if timeout_s is None else now_ns + nanoseconds(timeout_s)


class CanFace(Face):
    """A channel's frames in real time on another python-can interface, for any client.

    Args:
        channel: the emulated wire.
        interface, address: python-can interface and channel that clients open too.
        dbc: path told to clients.
        device: name in errors.
        listens: whether somebody on the emulated bus hears what clients send.
        told: what clients are told besides.
        options: further keyword arguments of the interface. Multicast without a `port` has a free one,
            because a host hears every group at the port that it listens to.
        at_close: is called when the face is closed.

    Raises:
        DeviceError: the interface cannot be opened.
    """

    def __init__(
        self,
        channel: CanChannel,
        *,
        interface: str = "udp_multicast",
        address: str = DEFAULT_GROUP,
        dbc: Path | str = "",
        device: str = "encoders",
        listens: bool = False,
        told: Mapping[str, object] | None = None,
        options: Mapping[str, Any] | None = None,
        at_close: Callable[[], None] = lambda: None,
    ) -> None:
        self._at_close = at_close
        self._channel, self._dbc, self._listens = channel, str(dbc), listens
        self._told = dict(told or {})
        self._echoes: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)
        self._interface, self._address, self._options = interface, address, dict(options or {})
        if interface == "udp_multicast":
            if "port" not in self._options:
                self._options["port"] = free_udp_port()
            self._options.setdefault("hop_limit", 0)
        try:
            self._bus: can.BusABC | None = can.Bus(interface=interface, channel=address, **self._options)
        except (can.CanError, OSError, ValueError, TypeError) as error:
            at_close()
            raise DeviceError(
                device,
                f"the emulated CAN bus cannot be served ({error})",
                port=f"{interface}:{address}",
                remedy="choose another python-can interface or address",
            ) from None
        self._mark = Mark(bus_name(interface, address, self._options), channel.bitrate)
        self._queue = channel.listen()
        self.sent = self.lost = 0

    def next_due_ns(self) -> int:
        """When the next frame has crossed the emulated wire."""
        return self._queue[0][0] if self._queue else NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Send what has crossed; a frame that the interface refuses is lost and counted."""
        while self._queue and self._queue[0][0] <= t_ns:
            message = self._queue.popleft()[1]
            if self._bus is None:
                continue
            try:
                self._bus.send(message)
                self.sent += 1
                if self._listens:
                    self._echoes.append((message.arbitration_id, bytes(message.data)))
            except (can.CanError, OSError):
                self.lost += 1

    def filenos(self) -> list[int]:
        """Descriptor of the interface where it has one."""
        if self._bus is None:
            return []
        with contextlib.suppress(NotImplementedError, OSError):
            descriptor = self._bus.fileno()
            return [descriptor] if descriptor >= 0 else []
        return []

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Take one frame, and throw it away where nobody listens; multicast hears itself, too."""
        message = None
        if self._bus is not None:
            with contextlib.suppress(can.CanError, OSError):
                message = self._bus.recv(0)
        if message is None or not self._listens:
            return
        key = (message.arbitration_id, bytes(message.data))
        if key in self._echoes:
            self._echoes.remove(key)
        else:
            self._channel.send(message, t_ns, sender=self._queue)

    def endpoint(self) -> dict[str, object]:
        """How a client reaches the bus."""
        return {
            "interface": self._interface,
            "channel": self._address,
            "bitrate": self._channel.bitrate,
            "dbc": self._dbc,
            **self._told,
            **{key: value for key, value in self._options.items() if key != "hop_limit"},
        }

    def close(self) -> None:
        """Let go of the interface. Idempotent."""
        if self._bus is not None:
            self._channel.leave(self._queue)
            self._bus.shutdown()
            self._bus = None
            self._at_close()
        self._mark.close()
