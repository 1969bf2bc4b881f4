"""The emulated CAN bus, in this process and in virtual time, as python-can interface `hil`.

`CanChannel` is the bus. `CanChannel.open` registers it under a name, and
`can.Bus(interface="hil", channel=NAME)` opens a `WorldBus` on it. `hil.fakes.can_bridge` connects other
processes.

Emulated devices and our own drivers share `CanFrame` objects; only `recv` makes a `can.Message`, because
that takes several times as long.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from copy import copy
from typing import Any, NamedTuple

import can

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import UsageError
from hil.fakes.periodic_frames import WorldSendTask
from hil.fakes.world import NEVER_NS, World
from hil.faults.fault import BOTH, IN, OUT, Supported
from hil.faults.messages import FRAME_FAULTS, Messages, declared

_BUS_FAULTS: Supported = {"bus_off": (), "unplug": (), "baud_mismatch": ()}

_QUEUE, _MOST_BYTES = 4096, 64
_OVERHEAD_BITS, _STUFFING = 47, 1.1

_CHANNELS: dict[str, CanChannel] = {}


class CanFrame(NamedTuple):
    """A received data frame, with the attribute names of `can.Message`.

    Attributes:
        timestamp: arrival time on the world's clock, s.
        arbitration_id, data, is_extended_id, is_remote_frame, is_error_frame: identifier, bytes and flags as
            in `can.Message`.
    """

    timestamp: float
    arbitration_id: int
    data: bytes
    is_extended_id: bool
    is_remote_frame: bool = False
    is_error_frame: bool = False

    @property
    def dlc(self) -> int:
        """Number of data bytes."""
        return len(self.data)


QueuedFrame = tuple[int, CanFrame | can.Message]
"""Arrival time in ns, and the frame; a `can.Message` if a python-can client has sent it."""


class CanChannel:
    """One CAN bus: frames are sent one after the other at the bit rate, and every listener receives them.

    Args:
        world: time, seed and faults.
        name: channel name for `can.Bus`.
        device: device name that wire faults apply to; a message is a frame.
    """

    def __init__(
        self, world: World, name: str = "hil", *, bitrate: int = 500_000, device: str = "encoders"
    ) -> None:
        self.world, self.name, self.bitrate, self._device = world, name, bitrate, device
        self._takes_ns = [
            [_takes_ns(extended, dlc, bitrate) for dlc in range(_MOST_BYTES + 1)]
            for extended in (False, True)
        ]
        self.faults = world.faults.of(device)
        self._listeners: list[tuple[deque[QueuedFrame], Callable[[], None] | None]] = []
        self._messages = Messages(world.faults, (device,), world.rng(f"can.{device}"), FRAME_FAULTS)
        self._free_ns = self._held_up_ns = 0
        self._bus_off_seen = False

    def open(self) -> CanChannel:
        """Register the channel for `can.Bus`; raises `UsageError` if the name is taken."""
        if _CHANNELS.setdefault(self.name, self) is not self:
            raise UsageError(
                f"CAN channel {self.name!r} exists already", remedy="close it or use another name"
            )
        return self

    def close(self) -> None:
        """Remove the channel from the registry. Idempotent."""
        if _CHANNELS.get(self.name) is self:
            del _CHANNELS[self.name]

    def declare(self, device: str, own: Supported, ways: str = BOTH) -> None:
        """Declare the faults of a device on this bus: its own ones, and those that it leaves to the bus.

        Args:
            device: its name.
            own: faults that it produces itself.
            ways: `IN` for a device that listens to no frame.
        """
        self.world.faults.declare(device, declared(own, _BUS_FAULTS, FRAME_FAULTS, ways))
        self._messages.leave_out(own)

    def listen(self, on_frames: Callable[[], None] | None = None) -> deque[QueuedFrame]:
        """Add a listener. Its queue holds (arrival time, frame); a full queue drops the oldest frames.

        Args:
            on_frames: called after a frame has been added.
        """
        queue: deque[QueuedFrame] = deque(maxlen=_QUEUE)
        self._listeners.append((queue, on_frames))
        return queue

    def leave(self, queue: deque[QueuedFrame]) -> None:
        """Remove the listener with this queue."""
        self._listeners = [(q, reported) for q, reported in self._listeners if q is not queue]

    def transmit(
        self,
        frame_id: int,
        data: bytes,
        t_ns: int,
        *,
        extended: bool = False,
        sender: deque[QueuedFrame] | None = None,
    ) -> None:
        """Send a data frame of the device, not before `t_ns`; every listener except `sender` receives it."""
        if not self.faults.empty:
            message = can.Message(arbitration_id=frame_id, data=data, is_extended_id=extended)
            self._send(message, t_ns, IN, sender)
            return
        arrival_ns = self._crossed_ns(extended, len(data), t_ns)
        frame = CanFrame(arrival_ns / NS_PER_S, frame_id, data, extended, False, False)
        for queue, reported in self._listeners:
            if queue is not sender:
                queue.append((arrival_ns, frame))
                if reported is not None:
                    reported()

    def send(self, message: can.Message, t_ns: int, *, sender: deque[QueuedFrame] | None = None) -> None:
        """Send any frame of a client and take ownership of it; every listener except `sender` receives it."""
        if self.faults.empty:
            arrival_ns = self._crossed_ns(message.is_extended_id, message.dlc, t_ns)
            self._hand_out(message, arrival_ns, sender)
        else:
            self._send(message, t_ns, OUT, sender)

    def _send(self, message: can.Message, t_ns: int, way: str, sender: deque[QueuedFrame] | None) -> None:
        """Send a frame as the faults of the bus leave it."""
        off = any(self.faults.find(self._device, kind, t_ns) for kind in ("bus_off", "baud_mismatch"))
        was_off, self._bus_off_seen = self._bus_off_seen, off
        if off:
            if not was_off:
                error = can.Message(is_error_frame=True, dlc=8, data=bytes(8))
                self._hand_out(error, self._crossed_ns(False, 8, t_ns), sender)
        elif not self.faults.find(self._device, "unplug", t_ns):
            for data in self._messages.received(bytes(message.data), t_ns, way):
                one = _copied(message)
                if data != one.data:
                    one.data, one.dlc = bytearray(data), len(data)
                self._hand_out(one, self._arrival_ns(one, t_ns, way), sender)

    def _arrival_ns(self, message: can.Message, t_ns: int, way: str) -> int:
        """Arrival time of a frame; frames of the device that it sends late leave the bus free until then."""
        if way == IN and max(t_ns, self._held_up_ns) > self.world.now_ns:
            begins_ns = max(t_ns, self._held_up_ns)
            self._held_up_ns = begins_ns + self._takes_ns[message.is_extended_id][message.dlc]
            return self._held_up_ns
        return self._crossed_ns(message.is_extended_id, message.dlc, t_ns)

    def _hand_out(self, message: can.Message, arrival_ns: int, sender: deque[QueuedFrame] | None) -> None:
        message.timestamp = arrival_ns / NS_PER_S
        for queue, reported in self._listeners:
            if queue is not sender:
                if queue and queue[-1][0] > arrival_ns:
                    _insert(queue, (arrival_ns, message))
                else:
                    queue.append((arrival_ns, message))
                if reported is not None:
                    reported()

    def _crossed_ns(self, extended: bool, dlc: int, t_ns: int) -> int:
        """Arrival time of a frame that is queued now; reserves the bus until then."""
        begins_ns = t_ns if t_ns > self._free_ns else self._free_ns
        self._free_ns = begins_ns + self._takes_ns[extended][dlc]
        return self._free_ns

    def check_plugged(self) -> None:
        """Raise `can.CanOperationError` during an `unplug` fault, as an unplugged CAN adapter does."""
        if not self.faults.empty and self.faults.find(self._device, "unplug", self.world.now_ns):
            raise can.CanOperationError("the CAN adapter is gone")


def _insert(queue: deque[QueuedFrame], frame: QueuedFrame) -> None:
    """Put a frame before those that arrive later; a full queue drops its oldest frame."""
    if len(queue) == queue.maxlen:
        queue.popleft()
    queue.insert(sum(at_ns <= frame[0] for at_ns, _ in queue), frame)


class WorldBus(can.BusABC):
    """python-can bus on a `CanChannel`. Waiting advances the world; time stamps are on the world's clock.

    Args:
        channel: name of the channel.
        can_filters: filters of received frames, as in `can.BusABC`.
        receive_own_messages: True if this bus also receives the frames that it sends.
        kwargs: arguments passed on to `can.BusABC`.
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
        self._receives_own = receive_own_messages
        self.channel_info = f"emulated CAN channel {found.name}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel, can_filters=can_filters, **kwargs)

    def take(self) -> CanFrame | can.Message | None:
        """Return the next frame like `recv` without waiting; the caller must not change the frame.

        Raises:
            can.CanOperationError: the adapter is unplugged.
        """
        world, queue = self._channel.world, self._queue
        if not self._channel.faults.empty:
            self._channel.check_plugged()
        while queue and queue[0][0] <= world.now_ns:
            frame = queue.popleft()[1]
            if self._filters is None or self._matches_filters(message_of(frame)):
                return frame
        return None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Wait in world time for the next frame. Raises `can.CanOperationError` if unplugged."""
        world, queue = self._channel.world, self._queue
        deadline_ns = None if timeout == 0 else _deadline_ns(world.now_ns, timeout)
        while True:
            frame = self.take()
            if frame is not None:
                message = message_of(frame)
                sender: Any = message.channel
                message.is_rx, message.channel = sender is not self, self._channel.name
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
        """Send a copy of a frame to all other listeners, and to this one if it receives its own messages.

        Raises:
            can.CanOperationError: the adapter is unplugged, or an FD frame is sent to a classical bus.
        """
        self._channel.check_plugged()
        if msg.is_fd:
            raise can.CanOperationError("a CAN FD frame cannot be sent on a classical bus")
        sender, own = None if self._receives_own else self._queue, _copied(msg)
        own.channel = self  # type: ignore[assignment]  # read back by `recv`
        self._channel.send(own, self._channel.world.now_ns, sender=sender)

    def _send_periodic_internal(
        self,
        msgs: Any,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> WorldSendTask:
        world = self._channel.world
        return WorldSendTask(world, self, msgs, period, duration, autostart, modifier_callback)

    def shutdown(self) -> None:
        """Stop listening on the channel."""
        if not self._is_shutdown:
            self._channel.leave(self._queue)
        super().shutdown()

    def __del__(self) -> None:
        """Do nothing: a fan's daemon may leave its bus open until its world ends."""

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        return [{"interface": "hil", "channel": name} for name in _CHANNELS]


def _takes_ns(extended: bool, dlc: int, bitrate: int) -> int:
    """Duration of a frame on the bus, ns."""
    bits = (_OVERHEAD_BITS + 20 * extended + 8 * dlc) * _STUFFING
    return round(bits * 1e9 / bitrate)


def message_of(frame: CanFrame | can.Message) -> can.Message:
    """Return the frame as a `can.Message` of its own, for clients of python-can."""
    if isinstance(frame, can.Message):
        return _copied(frame)
    return can.Message(frame.timestamp, frame.arbitration_id, frame.is_extended_id, data=frame.data)


def _copied(message: can.Message) -> can.Message:
    """Copy a message with its data; `deepcopy` takes three times as long."""
    own = copy(message)
    if own.data:
        own.data = bytearray(own.data)
    return own


def _deadline_ns(now_ns: int, timeout_s: float | None) -> int:
    return NEVER_NS if timeout_s is None else now_ns + nanoseconds(timeout_s)
