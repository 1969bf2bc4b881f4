"""Load cells whose counts come as lines `LC <number> <counts> <counts>`, 16-bit number, on a serial port."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from hil.config.load_cells import LineCellsConfig
from hil.drivers.load_cells.judging import Judge
from hil.drivers.patience import Usefulness, used_while_closed
from hil.drivers.serial_url import PORT_ERRORS, cannot_open, let_go, open_serial
from hil.vocabulary.clock import NS_PER_S, Clock, nanoseconds
from hil.vocabulary.errors import DeviceTimeoutError
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.signals import LoadCellSample

_LINE = re.compile(rb"LC (\d{1,5}) (-?\d{1,8}) (-?\d{1,8})\r?")
_COUNTS = 1 << 23
_MOST_BYTES = 4096
_WAIT_S = 0.02


class LineCells(Sensor[LoadCellSample]):
    """Two cells behind a serial line; the port is only read, so that the propellers may use it too.

    Args:
        config: port, scales.
        clock: the bench clock.

    Attributes:
        malformed: lines since `open` that are no conversion.
    """

    name = "load_cells"

    def __init__(self, config: LineCellsConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._port: Any = None
        self._identity: dict[str, str] = {}
        self._usefulness = Usefulness(config.fail_after_s)
        self._judge = Judge(config)
        self._rest = bytearray()
        self.malformed = 0

    def open(self) -> None:
        """Open the port and wait for a first line; raises `DeviceError`."""
        self.close()
        config = self._config
        try:
            self._port = open_serial(
                config.port, baud=config.baud, timeout_s=0.0, write_timeout_s=0.1, shared=True
            )
        except PORT_ERRORS as error:
            expected = "lines of load cells at a serial port or pyserial URL"
            raise cannot_open(self.name, config.port, error, expected=expected) from None
        self._rest, self.malformed, self._judge = bytearray(), 0, Judge(config)
        for _ in range(math.ceil(config.open_timeout_s / _WAIT_S)):
            if self._conversions():
                break
            self._clock.sleep_until_ns(self._clock.now_ns() + nanoseconds(_WAIT_S))
        else:
            heard = self.malformed
            self.close()
            raise self._silent(config.open_timeout_s, heard)
        self._usefulness.begin(self._clock.now_ns())
        self._identity = {"model": "HX711", "port": config.port, "baud": str(config.baud)}

    def close(self) -> None:
        """Let go of the port. Idempotent; never raises."""
        self._identity = {}
        port, self._port = self._port, None
        let_go(port)

    def identity(self) -> Mapping[str, str]:
        """Model, port and baud rate; empty while closed."""
        return self._identity

    def read(self) -> tuple[LoadCellSample, ...]:
        """All conversions since the last call, oldest first.

        Raises:
            DeviceError: it is closed.
            DeviceTimeoutError: none came for `fail_after_s`.
        """
        if self._port is None:
            raise used_while_closed(self.name, self._config.port)
        now_ns = self._clock.now_ns()
        found = self._conversions()
        period_ns = round(NS_PER_S / self._config.rate_hz)
        samples = tuple(
            self._judge.sample(raw, now_ns - (len(found) - 1 - k) * period_ns, now_ns)
            for k, raw in enumerate(found)
        )
        if lost_ns := self._usefulness.lost_ns(bool(samples), now_ns):
            raise self._silent(lost_ns / NS_PER_S, self.malformed)
        return samples

    def _conversions(self) -> list[tuple[int, int]]:
        """Counts of the lines that have arrived."""
        try:
            waiting = self._port.in_waiting
            self._rest += self._port.read(min(waiting, _MOST_BYTES)) if waiting else b""
        except PORT_ERRORS:
            return []
        *lines, rest = bytes(self._rest).split(b"\n")
        self._rest = bytearray(rest[-_MOST_BYTES:])
        found = []
        for line in lines:
            match = _LINE.fullmatch(line)
            counts = (0, 0) if match is None else (int(match[2]), int(match[3]))
            if match is None or max(map(abs, counts)) > _COUNTS:
                self.malformed += 1
            else:
                found.append(counts)
        return found

    def _silent(self, duration_s: float, malformed: int) -> DeviceTimeoutError:
        seen = f", {malformed} lines that are none" * bool(malformed)
        return DeviceTimeoutError(
            self.name,
            f"no conversion for {duration_s:.1f} s{seen}",
            port=self._config.port,
            expected=f"{self._config.rate_hz:g} lines per second",
            remedy="check cable, supply and baud rate of the cells' microcontroller",
        )
