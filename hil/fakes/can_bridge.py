"""Bridges the emulated CAN bus to other processes: its frames in real time on another python-can interface.

The default interface is UDP multicast among the programs of this host.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import can

from hil.core.errors import DeviceError
from hil.fakes.can_channel import CanChannel, message_of
from hil.fakes.emulated_can_group import DEFAULT_GROUP
from hil.fakes.free_port import free_udp_port
from hil.fakes.server import Transport
from hil.fakes.world import NEVER_NS
from hil.support.emulated_can_mark import Mark, bus_name
from hil.support.local_can_multicast import HostMulticastBus

_ECHOES = 256


class CanTransport(Transport):
    """Bridge between a channel and another python-can interface, in real time, for any client.

    Args:
        channel: the emulated bus.
        interface, address: python-can interface and channel that clients open.
        dbc: path of the DBC file for clients.
        device: device name for error messages.
        listens: True if a device on the emulated bus receives what clients send.
        printed: further values for the endpoint.
        options: further keyword arguments of the interface. Multicast without a `port` gets a free one,
            because python-can's own bus receives every group at its port.
        at_close: called when the transport is closed.

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
        printed: Mapping[str, object] | None = None,
        options: Mapping[str, Any] | None = None,
        at_close: Callable[[], None] = lambda: None,
    ) -> None:
        self._at_close = at_close
        self._channel, self._dbc, self._listens = channel, str(dbc), listens
        self._printed = dict(printed or {})
        self._echoes: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)
        self._interface, self._address, self._options = interface, address, dict(options or {})
        if interface == "udp_multicast" and "port" not in self._options:
            self._options["port"] = free_udp_port()
        try:
            self._bus: can.BusABC | None = self._opened()
        except Exception as error:  # whatever its interface raises
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

    def _opened(self) -> can.BusABC:
        """Open the interface; multicast receives from this host only."""
        if self._interface == "udp_multicast":
            return HostMulticastBus(self._address, **self._options)
        return can.Bus(interface=self._interface, channel=self._address, **self._options)

    def next_due_ns(self) -> int:
        """Time at which the next frame has crossed the emulated bus."""
        return self._queue[0][0] if self._queue else NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Send the frames that have crossed the bus; count those that the interface rejects in `lost`."""
        while self._queue and self._queue[0][0] <= t_ns:
            message = message_of(self._queue.popleft()[1])
            if self._bus is None:
                continue
            try:
                self._bus.send(message)
                self.sent += 1
                if self._listens:
                    self._echoes.append((message.arbitration_id, bytes(message.data)))
            except Exception:  # whatever its interface raises
                self.lost += 1

    def filenos(self) -> list[int]:
        """File descriptor of the interface, if it has one."""
        if self._bus is None:
            return []
        with contextlib.suppress(NotImplementedError, OSError):
            descriptor = self._bus.fileno()
            return [descriptor] if descriptor >= 0 else []
        return []

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Pass one received frame to the channel, unless it is an echo of an own frame or nothing listens.

        An FD frame is none on a classical bus.
        """
        message = None
        if self._bus is not None:
            with contextlib.suppress(Exception):  # whatever its interface raises
                message = self._bus.recv(0)
        if message is None or message.is_fd or not self._listens:
            return
        key = (message.arbitration_id, bytes(message.data))
        if key in self._echoes:
            self._echoes.remove(key)
        else:
            self._channel.send(message, t_ns, sender=self._queue)

    def endpoint(self) -> dict[str, object]:
        """Interface, address and options with which a client opens the bus."""
        return {
            "interface": self._interface,
            "channel": self._address,
            "bitrate": self._channel.bitrate,
            "dbc": self._dbc,
            **self._printed,
            **{key: value for key, value in self._options.items() if key != "hop_limit"},
        }

    def close(self) -> None:
        """Close the interface. Idempotent."""
        if self._bus is not None:
            self._channel.leave(self._queue)
            self._bus.shutdown()
            self._bus = None
            self._at_close()
        self._mark.close()
