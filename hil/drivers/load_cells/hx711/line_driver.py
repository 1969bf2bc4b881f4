"""Driver of two load cells behind a serial line."""

import re
from collections.abc import Mapping

from hil.config.load_cells import LineCellsConfig
from hil.core.signals import LoadCellSample, Stamp
from hil.drivers.load_cells.hx711.counts_to_force import Judge
from hil.links.packets import LineParser
from hil.links.serial_port import SerialPort
from hil.streams.serial_sensor import SerialSensor

_LINE = re.compile(rb"LC (\d{1,5}) (-?\d{1,8}) (-?\d{1,8})")
_COUNTS = 1 << 23


class LineCells(SerialSensor[LineCellsConfig, LoadCellSample]):
    """Two cells behind a serial line; the port is only read, so that the propellers may use it too.

    Attributes:
        malformed: lines since `open` that are no conversion.
    """

    name, what, shared = "load_cells", "conversion", True
    expected = "lines of load cells at a serial port or pyserial URL"
    remedy = "check cable, supply and baud rate of the cells' microcontroller"
    malformed = 0

    def identify(self, port: SerialPort) -> Mapping[str, str]:
        """Wait for a first line."""
        self._lines, self.malformed, self._judge = LineParser(), 0, Judge(self.config)
        timeout_s = self.config.open_timeout_s
        if (
            port.request(b"", self._conversions, lambda item: item, clock=self.clock, timeout_s=timeout_s)
            is None
        ):
            raise self.silent(f"no conversion for {timeout_s:.1f} s")
        return {"model": "HX711", "baud": str(self.config.baud)}

    def parse(self, data: bytes, now_ns: int) -> list[tuple[int, int]]:
        """Counts (2 whole numbers) of the lines that these bytes complete."""
        return self._conversions(data)

    def _conversions(self, data: bytes) -> list[tuple[int, int]]:
        found = []
        for line in self._lines.feed(data):
            match = _LINE.fullmatch(line)
            counts = (0, 0) if match is None else (int(match[2]), int(match[3]))
            if match is None or max(map(abs, counts)) > _COUNTS:
                self.malformed += 1
            else:
                found.append(counts)
        return found

    def sample(self, item: tuple[int, int], stamp: Stamp) -> LoadCellSample:
        """Forces and what is wrong with them."""
        return self._judge.sample(item, stamp)

    def silence_details(self) -> str:
        """Lines that are no conversion, if any."""
        return f", {self.malformed} lines that are none" * bool(self.malformed)
