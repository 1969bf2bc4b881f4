"""A TF-Luna as a sensor: set up when opened, read as a stream, set up again when its power was gone."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from hil.drivers.patience import used_while_closed
from hil.drivers.stuck import StuckTest
from hil.vocabulary.clock import NS_PER_S, Clock, nanoseconds
from hil.vocabulary.errors import DeviceError, DeviceTimeoutError
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.signals import Stamp, Status
from hil_rangefinder import packets as p
from hil_rangefinder.config import FIELD_OF_VIEW_RAD, LEAST_M, MOST_M, TfLunaConfig
from hil_rangefinder.link import Link
from hil_rangefinder.sample import RangeSample

_REMEDY = "check power (5 V) and cable: RX and TX crossed, and the baud rate"
_UNIT_M = {"cm": 0.01, "mm": 0.001}
_FORMAT = {"cm": p.CENTIMETRES, "mm": p.MILLIMETRES}
_BAR_CODE_NS = nanoseconds(0.3)
_SET_AGAIN_NS = nanoseconds(0.2)


class TfLuna(Sensor[RangeSample]):
    """One range finder.

    Args:
        config: port, settings and limits.
        clock: the bench clock; every wait and every stamp is on it.
    """

    name = "rangefinder"

    def __init__(self, config: TfLunaConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._link: Link | None = None
        self._identity: dict[str, str] = {}
        self._unit_m = _UNIT_M[config.resolution]
        self._period_ns = nanoseconds(1.0 / config.rate_hz)
        self._silence_ns = max(nanoseconds(config.silence_s), 4 * self._period_ns)
        self._fail_ns = max(nanoseconds(config.fail_after_s), 8 * self._period_ns)
        self._settings = {
            p.FORMAT: bytes((_FORMAT[config.resolution],)),
            p.RATE: struct.pack("<H", config.rate_hz),
            p.OUTPUT: b"\x01",
        }
        self._stuck = StuckTest(config.stuck_after_s)
        self._sequence = self._t_ns = 0

    def open(self) -> None:
        """Open the port, ask for the firmware, write the settings.

        Raises:
            DeviceTimeoutError: nothing answered.
            DeviceError: the port cannot be used, or a setting was not taken.
        """
        self.close()
        link = self._link = Link(self.name, self._config.port, self._config.baud, self._clock)
        try:
            self._identity = self._identify(link)
            self._set_up(link)
        except BaseException:
            self.close()
            raise
        now_ns = self._clock.now_ns()
        self._heard_ns = self._read_ns = now_ns
        self._unconfirmed: set[int] = set()
        self._set_again_ns = now_ns
        self._settled_ns = now_ns + 2 * self._period_ns
        self._stuck.reset(now_ns)

    def close(self) -> None:
        """Let go of the port; the sensor goes on by itself. Idempotent."""
        self._identity = {}
        if self._link is not None:
            self._link.close()
            self._link = None

    def identity(self) -> Mapping[str, str]:
        """Model, firmware, serial number and port; empty while closed."""
        return self._identity

    def read(self) -> tuple[RangeSample, ...]:
        """Every distance since the last call.

        Raises:
            DeviceTimeoutError: no distance, good or bad, for `fail_after_s`.
        """
        link = self._opened()
        now_ns = self._clock.now_ns()
        unread_ns, self._read_ns = now_ns - self._read_ns, now_ns
        if unread_ns > self._silence_ns:  # nobody listened: what happened meanwhile is not known
            self._heard_ns = now_ns - self._silence_ns - 1
        arrived = link.arrived()
        now_ns = self._clock.now_ns()
        self._watch_settings(link, arrived, now_ns)
        data = [item for item in arrived if not isinstance(item, p.Answer)]
        if any(isinstance(item, p.Reading) for item in data):
            self._heard_ns = now_ns
        elif now_ns - self._heard_ns > self._fail_ns:
            raise DeviceTimeoutError(
                self.name,
                f"no distance for {(now_ns - self._heard_ns) / NS_PER_S:.1f} s",
                port=self._config.port,
                expected=f"{self._config.rate_hz} per second",
                remedy=_REMEDY,
            )
        last = len(data) - 1
        return tuple(self._sample(item, now_ns, last - k) for k, item in enumerate(data))

    def _opened(self) -> Link:
        if self._link is None:
            raise used_while_closed(self.name, self._config.port)
        return self._link

    def _identify(self, link: Link) -> dict[str, str]:
        until_ns = self._clock.now_ns() + nanoseconds(self._config.open_timeout_s)
        version = link.ask(p.VERSION, until_ns=until_ns)
        if version is None or len(version) != 3:
            raise DeviceTimeoutError(
                self.name,
                "no answer",
                port=self._config.port,
                expected=f"a TF-Luna at {self._config.baud} baud",
                remedy=_REMEDY,
            )
        found = {"model": "TF-Luna", "firmware": firmware(version)}
        bar_code = link.ask(p.BAR_CODE, until_ns=self._clock.now_ns() + _BAR_CODE_NS)
        serial = (bar_code or b"").decode("ascii", "replace").strip("\0 ")
        return {**found, **({"serial": serial} if serial else {}), "port": self._config.port}

    def _set_up(self, link: Link) -> None:
        wanted = {**self._settings, **({p.SAVE: b""} if self._config.save else {})}
        for command, payload in wanted.items():
            until_ns = self._clock.now_ns() + nanoseconds(self._config.open_timeout_s)
            answer = link.ask(command, payload, until_ns=until_ns)
            if answer != (payload or b"\0"):
                told = "nothing" if answer is None else answer.hex(" ")
                raise DeviceError(
                    self.name,
                    f"setting 0x{command:02X} was answered with {told}",
                    port=self._config.port,
                    expected=(payload or b"\0").hex(" "),
                    remedy="update the sensor's firmware",
                )

    def _watch_settings(self, link: Link, arrived: list[p.Reading | p.Answer | p.Lost], now_ns: int) -> None:
        """After a silence send the settings again: without power the sensor forgets them.

        What was measured before they were taken may come after their answer.
        """
        if now_ns - self._heard_ns > self._silence_ns:
            self._unconfirmed = set(self._settings)
        for item in arrived:
            if isinstance(item, p.Answer) and self._settings.get(item.command) == item.payload:
                self._unconfirmed.discard(item.command)
                self._settled_ns = now_ns + 2 * self._period_ns
        if self._unconfirmed and now_ns >= self._set_again_ns:
            self._set_again_ns = now_ns + _SET_AGAIN_NS
            for command in self._unconfirmed:
                link.tell(command, self._settings[command])

    def _sample(self, item: p.Reading | p.Lost | p.Answer, host_ns: int, newer: int) -> RangeSample:
        """A reading as a sample; `newer` more have come with it."""
        self._sequence += 1
        t_ns = host_ns - nanoseconds(self._config.latency_s) - newer * self._period_ns
        self._t_ns = max(t_ns, self._t_ns + 1)
        stamp = Stamp(self._t_ns, host_ns, self._sequence)
        limits = (LEAST_M, MOST_M, FIELD_OF_VIEW_RAD)
        if not isinstance(item, p.Reading):
            return RangeSample(stamp, math.nan, 0, math.nan, *limits, Status.CRC)
        status = self._judge(item, host_ns)
        distance_m = item.distance * self._unit_m if status is Status.OK else math.nan
        return RangeSample(stamp, distance_m, item.strength, item.temperature_c, *limits, status)

    def _judge(self, reading: p.Reading, host_ns: int) -> Status:
        stuck = self._stuck.stuck(reading, self._t_ns)
        if self._unconfirmed or host_ns < self._settled_ns:
            return Status.STARTING
        if reading.strength < p.WEAK or reading.strength == p.OVEREXPOSED:
            return Status.LOW_CONFIDENCE
        if not LEAST_M <= reading.distance * self._unit_m <= MOST_M:
            return Status.IMPLAUSIBLE
        return Status.FROZEN if stuck else Status.OK


def firmware(version: bytes) -> str:
    """A version as the manual writes it: three bytes, the last one first."""
    return ".".join(str(number) for number in reversed(version))
