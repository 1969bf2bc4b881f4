"""TF-Luna driver: set up when opened, read as a stream, set up again when its power was gone."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from hil.devkit.driver import Clock, DeviceError, SerialPort, SerialSensor, Stamp, Status, nanoseconds
from hil_rangefinder import LEAST_M, MOST_M, RangeSample, TfLunaConfig
from hil_rangefinder import protocol as p

_BAR_CODE_S = 0.3
_SET_AGAIN_NS = nanoseconds(0.2)


class TfLunaDriver(SerialSensor[TfLunaConfig, RangeSample]):
    """One range finder."""

    name, what = "rangefinder", "distance"
    expected = "a TF-Luna at a serial port or pyserial URL"
    remedy = "check power (5 V) and cable: RX and TX crossed, and the baud rate"

    def __init__(self, config: TfLunaConfig, clock: Clock) -> None:
        super().__init__(config, clock)
        unit, self._unit_m = p.UNITS[config.resolution]
        self._settings = {p.FORMAT: unit, p.RATE: struct.pack("<H", round(config.rate_hz)), p.OUTPUT: b"\x01"}
        self._silence_ns = max(nanoseconds(config.silence_s), 4 * self.period_ns)

    def identify(self, port: SerialPort) -> Mapping[str, str]:
        """Ask for firmware and serial number."""
        self._parser, self._unconfirmed = p.parser(), set[int]()
        self._retry_ns = self._valid_ns = 0
        version = self._ask(port, p.Command(p.VERSION), self.config.open_timeout_s)
        if version is None or len(version) != 3:
            raise self.silent("no answer")
        bar_code = self._ask(port, p.Command(p.BAR_CODE), _BAR_CODE_S) or b""
        serial = bar_code.decode("ascii", "replace").strip("\0 ")
        firmware = ".".join(str(number) for number in reversed(version))
        return {"model": "TF-Luna", "firmware": firmware, **({"serial": serial} if serial else {})}

    def configure(self, port: SerialPort) -> None:
        """Write the settings; raises `DeviceError` for one that is not taken."""
        save = {p.SAVE: b""} if self.config.save else {}
        for code, payload in {**self._settings, **save}.items():
            answer = self._ask(port, p.Command(code, payload), self.config.open_timeout_s)
            received = "nothing" if answer is None else answer.hex(" ")
            if answer != (payload or b"\0"):
                raise DeviceError(
                    self.name,
                    f"setting 0x{code:02X} was answered with {received}",
                    port=port.url,
                    expected=(payload or b"\0").hex(" "),
                    remedy="update the sensor's firmware",
                )
        self._valid_ns = self.clock.now_ns() + 2 * self.period_ns

    def _ask(self, port: SerialPort, command: p.Command, timeout_s: float) -> bytes | None:
        """Payload of the answer; None where none comes."""

        def payload(packet: p.Reading | p.Command | None) -> bytes | None:
            is_answer = isinstance(packet, p.Command) and packet.code == command.code
            return packet.payload if is_answer else None  # type: ignore[union-attr]

        return port.request(
            command.packet(), self._parser.feed, payload, clock=self.clock, timeout_s=timeout_s
        )

    def parse(self, data: bytes, now_ns: int) -> list[p.Reading | None]:
        """Readings; after a silence the settings are sent again: without power the sensor forgets them.

        What was measured before they were taken may come after their answer.
        """
        packets = self._parser.feed(data)
        if now_ns - self.heard_ns > self._silence_ns:
            self._unconfirmed = set(self._settings)
        for packet in packets:
            if isinstance(packet, p.Command) and self._settings.get(packet.code) == packet.payload:
                self._unconfirmed.discard(packet.code)
                self._valid_ns = now_ns + 2 * self.period_ns
        if self._unconfirmed and now_ns >= self._retry_ns and self.port is not None:
            self._retry_ns = now_ns + _SET_AGAIN_NS
            for code in self._unconfirmed:
                self.port.write(p.Command(code, self._settings[code]).packet())
        return [packet for packet in packets if not isinstance(packet, p.Command)]

    def sample(self, item: p.Reading | None, stamp: Stamp) -> RangeSample:
        """A reading and its status."""
        if item is None:
            return RangeSample(stamp, math.nan, 0, math.nan, Status.CRC)
        distance_m = item.distance * self._unit_m
        status = self._judge(item, distance_m, stamp)
        distance_m = distance_m if status is Status.OK else math.nan
        return RangeSample(stamp, distance_m, item.strength, item.temperature_c, status)

    def _judge(self, item: p.Reading, distance_m: float, stamp: Stamp) -> Status:
        stuck = self.stuck.stuck(item, stamp.t_ns)
        if self._unconfirmed or stamp.host_ns < self._valid_ns:
            return Status.STARTING
        if item.strength < p.WEAK or item.strength == p.OVEREXPOSED:
            return Status.LOW_CONFIDENCE
        if not LEAST_M <= distance_m <= MOST_M:
            return Status.IMPLAUSIBLE
        return Status.FROZEN if stuck else Status.OK
