"""The serial port of a MicroStrain sensor, which can fail and be opened again. Never waits for bytes."""

from typing import Any

from hil.config.microstrain import BITS_PER_BYTE, MicrostrainConfig
from hil.core.clock import nanoseconds
from hil.core.errors import DeviceError
from hil.links.mip.packets import LARGEST_BYTES
from hil.links.serial_url import PORT_ERRORS, cannot_open, close_quietly, open_serial

_EXPECTED = "a MicroStrain sensor at a serial port or pyserial URL"
_CHUNK = 4096
_WRITE_TIMEOUT_S = 0.1


def longest_packet_ns(config: MicrostrainConfig) -> int:
    """Longest time from the first to the last byte of a packet, ns."""
    return nanoseconds(1.3 * LARGEST_BYTES * BITS_PER_BYTE / config.baud)


class LinkLostError(Exception):
    """The port has failed and is closed; stays inside this package."""


class Link:
    """The port, open or not.

    Args:
        config: port and baud rate.
        name: device name in errors.
    """

    def __init__(self, config: MicrostrainConfig, name: str) -> None:
        self._config, self._name = config, name
        self._port: Any = None

    @property
    def is_open(self) -> bool:
        """Whether there is a port to read from."""
        return self._port is not None

    def open(self) -> None:
        """Open the port; raises `DeviceError`."""
        try:
            self._open()
        except PORT_ERRORS as error:
            raise self._unusable(error) from None

    def reopen(self) -> None:
        """Open the port again; raises `LinkLostError`."""
        try:
            self._open()
        except PORT_ERRORS as error:
            raise self._lost(error) from None

    def close(self) -> None:
        """Close the port; never raises."""
        port, self._port = self._port, None
        close_quietly(port)

    def receive(self) -> bytes:
        """Bytes that have arrived; raises `LinkLostError`."""
        try:
            data: bytes = self._port.read(_CHUNK)
        except PORT_ERRORS as error:
            raise self._lost(error) from None
        return data

    def send(self, data: bytes) -> None:
        """Write bytes to the port; raises `LinkLostError`."""
        try:
            self._port.write(data)
        except PORT_ERRORS as error:
            raise self._lost(error) from None

    def _open(self) -> None:
        self._port = open_serial(
            self._config.port, baud=self._config.baud, timeout_s=0.0, write_timeout_s=_WRITE_TIMEOUT_S
        )

    def _lost(self, error: Exception) -> LinkLostError:
        self.close()
        return LinkLostError(f"the port failed ({error})")

    def _unusable(self, error: Exception) -> DeviceError:
        return cannot_open(self._name, self._config.port, error, expected=_EXPECTED)
