"""Opens a bus of python-can; any exception of its interface is a failure of the bus.

python-can's interfaces raise what the libraries below them raise: a cut line of slcan is an `IndexError`, a
connection that python-can-remote has lost is a class of its own. Closing may wait for ever for the other end.
"""

import contextlib
import logging
import os
import socket
import threading
from functools import partial
from typing import Any

import can

from hil.core.errors import DeviceError, HilError
from hil.support.emulated_can_mark import bitrate_of, bus_name, stays_on_host

_LOG = logging.getLogger(__name__)
_MULTICAST_ALL = ((socket.IPPROTO_IP, 49), (socket.IPPROTO_IPV6, 29))
"""`IP_MULTICAST_ALL` and `IPV6_MULTICAST_ALL` of Linux (/usr/include/linux/in.h, in6.h)."""
_SHUT_S = 0.5


class BusFailedError(Exception):
    """An interface has raised an exception, which is the cause; stays inside drivers and fan daemon."""


class OpenBus:
    """An open bus whose only exception is `BusFailedError`, beside a stop of the bench.

    Args:
        bus: open bus of any interface. An emulated one of this process has `take`, whose frames look like
            messages of python-can and must not be changed.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._take = getattr(bus, "take", None) or partial(bus.recv, 0)

    def receive(self, wait_s: float = 0.0) -> can.Message | None:
        """The next frame, or None after `wait_s`."""
        try:
            message: can.Message | None = self._bus.recv(wait_s) if wait_s else self._take()
        except HilError:
            raise
        except Exception as error:
            raise BusFailedError(_text(error)) from error
        return message

    def send(self, frame_id: int, data: bytes, *, extended: bool) -> None:
        """Send a frame."""
        try:
            self._bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=extended))
        except HilError:
            raise
        except Exception as error:
            raise BusFailedError(_text(error)) from error

    def shut(self) -> None:
        """Shut the bus down, or leave that to a thread after 0.5 s; never raises."""
        worker = threading.Thread(target=self._shut, name="closing CAN", daemon=True)
        worker.start()
        worker.join(_SHUT_S)

    def _shut(self) -> None:
        try:
            self._bus.shutdown()
        except Exception as error:
            _LOG.debug("a CAN bus did not shut down cleanly (%s)", _text(error))
            bus: Any = self._bus
            with contextlib.suppress(Exception):  # else its destructor tries again, and prints the exception
                can.BusABC.shutdown(bus)
                bus.socket.close()


def _text(error: Exception) -> str:
    """An error in words; of one that no bus should raise also its class."""
    plain = isinstance(error, (can.CanError, OSError)) and str(error)
    return str(error) if plain else f"{type(error).__name__}: {error}".removesuffix(": ")


def open_bus(
    device: str, config: Any, expected: str = "a python-can interface and channel that exist"
) -> can.BusABC:
    """The bus of a table with `interface`, `channel`, `bitrate` and `options`.

    Raises:
        DeviceError: it cannot be opened, or is emulated with another bit rate; named after the device.
    """
    _check_bitrate(device, config)
    options: dict[str, Any] = dict(config.options)
    try:
        if stays_on_host(config.interface, config.channel, options):
            from hil.support.local_can_multicast import HostMulticastBus  # a daemon on SocketCAN needs none

            return HostMulticastBus(config.channel, **options)
        bus = can.Bus(interface=config.interface, channel=config.channel, bitrate=config.bitrate, **options)
        return of_own_group(config.interface, bus)
    except HilError:
        raise
    except Exception as error:
        raise DeviceError(
            device,
            f"the CAN bus cannot be opened ({_text(error)})",
            port=f"{config.interface}:{config.channel}",
            expected=expected,
            remedy=f"check {device}.interface and {device}.channel; bring the interface up",
        ) from None


def of_own_group(interface: str, bus: can.BusABC) -> can.BusABC:
    """Restrict an open bus to frames of the multicast group that it has joined; returns the bus.

    python-can binds to the port alone, and Linux then delivers frames of every group that any program of the
    host has joined. Frames sent to the address of this host itself, not to a group, still arrive.

    Args:
        interface: name of python-can's interface; the bus of any other than `udp_multicast` is left as it is.
        bus: bus that was just opened; its `fileno` is that of its socket.
    """
    if interface == "udp_multicast":
        with socket.socket(fileno=os.dup(bus.fileno())) as same:
            for level, option in _MULTICAST_ALL:
                with contextlib.suppress(OSError):  # the option of the other version of IP, or another system
                    same.setsockopt(level, option, 0)
    return bus


def _check_bitrate(device: str, config: Any) -> None:
    """Raise `DeviceError` for an emulated bus of another bit rate; a real one has only errors, or silence."""
    there = bitrate_of(bus_name(config.interface, config.channel, config.options))
    if there is not None and there != config.bitrate:
        raise DeviceError(
            device,
            f"the bus runs at {there} bit/s, {device}.bitrate is {config.bitrate}: no frame would arrive",
            port=f"{config.interface}:{config.channel}",
            expected="one bit rate on all of the bus",
            remedy=f"set {device}.bitrate = {there}",
        )
