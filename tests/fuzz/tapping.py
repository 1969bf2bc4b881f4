"""Listens on every emulated wire of this process, and spoils what comes back to the driver when asked to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import can

from hil.fakes.can_channel import WorldBus
from hil.fakes.mocap.natnet.virtual_network import WorldPort
from hil.fakes.protocol_hil import Serial
from hil.fakes.tracker.mavlink.links import WorldLink

Spoil = Callable[[bytes], bytes]


def frame_bytes(message: can.Message) -> bytes:
    """A CAN frame as bytes: identifier, flags, data."""
    flags = message.is_extended_id | message.is_remote_frame << 1 | message.is_error_frame << 2
    return message.arbitration_id.to_bytes(4, "big") + bytes([flags]) + bytes(message.data)


def frame_of(data: bytes) -> can.Message:
    """Some CAN frame for any bytes."""
    head = data[:5].ljust(5, b"\0")
    extended, remote, error = (bool(head[4] & bit) for bit in (1, 2, 4))
    identifier = int.from_bytes(head[:4], "big") & (0x1FFFFFFF if extended else 0x7FF)
    body = b"" if remote else data[5:13]
    return can.Message(
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote and not error,
        is_error_frame=error,
        data=body,
        dlc=len(body),
    )


@dataclass
class Tap:
    """What went over the wires.

    Attributes:
        sent, received: messages of the driver, and those that it got.
        spoil: what becomes of a message on its way to the driver.
    """

    sent: list[bytes] = field(default_factory=list)
    received: list[bytes] = field(default_factory=list)
    spoil: Spoil | None = None

    def passed(self, data: bytes) -> bytes:
        """A message on its way to the driver."""
        if self.spoil is not None:
            return self.spoil(data)
        if data:
            self.received.append(data)
        return data


@contextmanager
def tapped() -> Iterator[Tap]:
    """A tap on pyserial's `hil://`, python-can's `hil`, and the datagrams of camera and motion capture."""
    tap = Tap()

    def on_write(original: Any) -> Any:
        def write(self: Any, data: Any, *rest: Any, **named: Any) -> Any:
            tap.sent.append(frame_bytes(data) if isinstance(data, can.Message) else bytes(data))
            return original(self, data, *rest, **named)

        return write

    def on_serial(original: Any) -> Any:
        def read(self: Any, size: int = 1) -> bytes:
            return tap.passed(original(self, size))[: max(size, 0)]

        return read

    def on_can(original: Any) -> Any:  # `recv` takes what `take` gives
        def take(self: Any) -> Any:
            message = original(self)
            if message is None:
                return None
            found = tap.passed(frame_bytes(message))
            if tap.spoil is None:
                return message
            strange = frame_of(found)
            strange.timestamp = message.timestamp
            return strange

        return take

    def on_datagram(original: Any) -> Any:
        def receive(self: Any) -> Any:
            arrival = original(self)
            return None if arrival is None else arrival._replace(data=tap.passed(arrival.data))

        return receive

    with (
        mock.patch.object(Serial, "write", on_write(Serial.write)),
        mock.patch.object(Serial, "read", on_serial(Serial.read)),
        mock.patch.object(WorldBus, "send", on_write(WorldBus.send)),
        mock.patch.object(WorldBus, "take", on_can(WorldBus.take)),
        mock.patch.object(WorldPort, "send", on_write(WorldPort.send)),
        mock.patch.object(WorldPort, "receive", on_datagram(WorldPort.receive)),
        mock.patch.object(WorldLink, "send", on_write(WorldLink.send)),
        mock.patch.object(WorldLink, "receive", on_datagram(WorldLink.receive)),
    ):
        yield tap
