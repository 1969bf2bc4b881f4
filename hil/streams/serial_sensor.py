"""A sensor that streams at a serial port."""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any

from hil.core.clock import Clock
from hil.core.errors import DeviceError
from hil.links.serial_port import PortLostError, SerialPort
from hil.streams.streaming_sensor import C, S, StreamingSensor


class SerialSensor(StreamingSensor[C, S]):
    """Base of the drivers of such sensors: define `identify`, `parse`, `sample`, and if needed `configure`.

    Attributes:
        port: the open port; None while closed.
        shared: True if another driver of this process may have the port open, too.
    """

    expected = "the device at a serial port or pyserial URL"
    remedy = "check power and cable: RX and TX crossed, and the baud rate"
    shared = False

    def __init__(self, config: C, clock: Clock) -> None:
        super().__init__(config, clock)
        self.port: SerialPort | None = None

    @property
    def place(self) -> str:
        """The serial port, for messages."""
        return str(self.config.port)

    @abstractmethod
    def identify(self, port: SerialPort) -> Mapping[str, str]:
        """What is at the open port: model, firmware, serial number. It changes no setting.

        Raises:
            DeviceError: nothing answers, or another device.
        """

    def configure(self, port: SerialPort) -> None:
        """Write the settings of the table to the device; raises `DeviceError` where that is refused."""
        return

    @abstractmethod
    def parse(self, data: bytes, now_ns: int) -> Iterable[Any]:
        """Measurements that these bytes complete; None for one that is damaged."""

    @classmethod
    def identify_only(cls, config: C, clock: Clock) -> Mapping[str, str] | None:
        """What is at a port, or None; no setting is changed."""
        driver = cls(config, clock)
        try:
            driver.port = driver._open_port()
            return driver.identify(driver.port)
        except DeviceError:
            return None
        finally:
            driver.close()

    def _open_port(self) -> SerialPort:
        return SerialPort(
            self.name, self.config.port, self.config.baud, expected=self.expected, shared=self.shared
        )

    def _connect(self) -> Mapping[str, str]:
        self.port = self._open_port()
        identity = self.identify(self.port)
        self.configure(self.port)
        return identity

    def _disconnect(self) -> None:
        port, self.port = self.port, None
        if port is not None:
            port.close()

    def _take(self, now_ns: int) -> list[tuple[Any, int]]:
        """Measurements with their arrival: the last one now, each one before it a period earlier."""
        if self.port is None:
            return []
        try:
            items = list(self.parse(self.port.read_available(), now_ns))
            self.port_gone = False
        except PortLostError:
            items, self.port_gone = [], True
        last = len(items) - 1
        return [(item, now_ns - (last - k) * self.period_ns) for k, item in enumerate(items)]
