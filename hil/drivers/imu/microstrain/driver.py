"""Driver of a MicroStrain sensor: drains its stream without waiting.

`open` sets the sensor up (`command_queue`); nothing else waits. A sensor that falls silent, has restarted
or sends something else is set up again while it is read, one command at a time. Its own time stamps are
mapped to the bench clock. `filter_samples` converts its data.
"""

import logging
import math
from collections.abc import Mapping

from hil.config.microstrain import MicrostrainConfig
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.interfaces import Sensor
from hil.core.signals import ImuSample, Stamp, Status
from hil.drivers.imu.microstrain import filter_samples
from hil.drivers.imu.microstrain.command_queue import (
    Dialogue,
    RefusedError,
    SetUp,
    UnsuitableError,
    answers,
    longest_packet_ns,
    open_port,
    set_up,
)
from hil.links.mip import fields as f
from hil.links.mip.packets import Packet, PacketParser
from hil.links.serial_port import PortLostError, SerialPort
from hil.streams.device_clock import DeviceClock
from hil.streams.silence_limit import SilenceTimer, used_while_closed
from hil.streams.stuck_values import StuckTest

_LOG = logging.getLogger(__name__)

REMEDY = "check power, wiring and baud rate (115200 when delivered)"
_LOOK_NS = 1_000_000
_SILENT_NS, _SILENT_PERIODS = 100_000_000, 10
_LOST_NS, _LOST_PERIODS = 500_000_000, 20
_NOISE_NS = 200_000_000
_SPOILT = "packets are spoilt on the way"
_REPORT_NS = 20_000_000
_REOPEN_NS = 200_000_000
_MOST_REJECTED = 3


class MicrostrainImu(Sensor[ImuSample]):
    """One sensor.

    Args:
        config: port, rate, budgets.
        clock: the bench clock; every wait and every stamp is on it.

    Attributes:
        latest: the last set of filter data, good or bad; None before the first.
        rate_hz: samples per second that the sensor has been set to; NaN before it has been.
    """

    name = "imu"

    @classmethod
    def identify_only(cls, config: MicrostrainConfig, clock: Clock) -> dict[str, str] | None:
        """{} where a MicroStrain sensor is at the port, else None. It keeps its settings."""
        return {} if answers(config, clock) else None

    def __init__(self, config: MicrostrainConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._port: SerialPort | None = None
        self._opened = False
        self._identity: dict[str, str] = {}
        self._dialogue: Dialogue | None = None
        self._parser = PacketParser(longest_packet_ns(config))
        self._device_clock = DeviceClock(nanoseconds(config.delay_s))
        self._stuck = StuckTest(config.stuck_after_s)
        self._silence_timer = SilenceTimer(config.fail_after_s)
        self._stale_ns = nanoseconds(config.stale_after_s)
        self._sequence = 0
        self.latest: f.FilterData | None = None
        self.rate_hz = math.nan

    def open(self) -> None:
        """Open the port, check which sensor answers, and set what it sends.

        Raises:
            DeviceTimeoutError: nothing answered.
            DeviceError: the port cannot be used, something else answered, or it refused.
        """
        self.close()
        self._port = port = open_port(self._config, self.name)
        self._opened = True
        self._parser.reset()
        self._device_clock.reset()
        self.latest = None
        now_ns = self._clock.now_ns()
        self._stuck.reset(now_ns)
        self._silence_timer.begin(now_ns)
        self._heard_ns = self._reported_ns = now_ns
        self._reopen_ns, self._noise_ns, self._trouble = 0, now_ns - _NOISE_NS, "nothing came"
        self._is_ours = self._just_set_up = self._restarted = False
        self._dialogue = self._new_dialogue(port)
        try:
            self._await_set_up(now_ns + nanoseconds(self._config.open_timeout_s))
        except BaseException:
            self.close()
            raise

    def reopen(self) -> None:
        """Open again after an outage: sample numbers go on, and the first sample has status RESET."""
        self.open()
        self._restarted = True

    @property
    def port_gone(self) -> bool:
        """Whether the port itself has failed."""
        return self._opened and self._port is None

    def close(self) -> None:
        """Close the port; the sensor goes on by itself. Idempotent."""
        self._identity, self._opened, self.rate_hz = {}, False, math.nan
        self._close_port()

    def _close_port(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def identity(self) -> Mapping[str, str]:
        """Model, serial number, firmware, rate and port; empty while closed."""
        return self._identity

    def read(self) -> tuple[ImuSample, ...]:
        """All samples that have come since the last call; empty when none has.

        Raises:
            DeviceTimeoutError: nothing usable for `fail_after_s`.
            DeviceError: another device answers, or the sensor refuses to be set up again.
        """
        if not self._opened:
            raise used_while_closed(self.name, self._config.port)
        now_ns = self._clock.now_ns()
        samples: list[ImuSample] = []
        try:
            samples += self._drain(now_ns)
            self._look_after(now_ns)
        except PortLostError as error:
            self._lose(error, now_ns)
        samples += self._missing(now_ns)
        self._judge(samples, now_ns)
        return tuple(samples)

    def _lose(self, error: DeviceError, now_ns: int) -> None:
        """Close a failed port; it is opened again later."""
        self._close_port()
        self._trouble, self._reopen_ns = error.what, now_ns + _REOPEN_NS

    def _new_dialogue(self, port: SerialPort) -> Dialogue:
        patience_ns = nanoseconds(self._config.reply_timeout_s)
        return Dialogue(lambda: set_up(self._config), port.write, patience_ns)

    def _await_set_up(self, deadline_ns: int) -> None:
        while (dialogue := self._dialogue) is not None:
            now_ns = self._clock.now_ns()
            if now_ns > deadline_ns:
                raise self._no_answer(dialogue, "")
            try:
                self._drain(now_ns)
                self._look_after(now_ns)
            except PortLostError as error:
                raise self._no_answer(dialogue, error.what) from None
            self._clock.sleep_until_ns(now_ns + _LOOK_NS)

    def _no_answer(self, dialogue: Dialogue, reason: str) -> DeviceError:
        what = "no MicroStrain sensor answers"
        if reason:
            what += f": {reason}"
        elif dialogue.answered:
            what = "the sensor stopped answering while it was set up"
        elif self._clock.now_ns() - self._noise_ns < _NOISE_NS:
            what += ", but what comes is no MIP packet"
        return DeviceTimeoutError(
            self.name,
            what,
            port=self._config.port,
            expected=f"answers to MIP commands at {self._config.baud} baud",
            remedy=REMEDY,
        )

    def _drain(self, now_ns: int) -> list[ImuSample]:
        """Parse what has arrived: data become samples, replies to commands go to the dialogue."""
        if self._port is None:
            return []
        parser = self._parser
        rejected, skipped = parser.rejected, parser.skipped
        samples: list[ImuSample] = []
        packets = parser.feed(self._port.read_available(), now_ns)
        for packet in packets:
            if packet.descriptor_set == f.FILTER_DATA:
                data = f.FilterData.of(packet)
                if data is not None:
                    samples += self._taken(data, now_ns)
            elif self._dialogue is not None:
                self._answered(self._dialogue, packet)
        if parser.rejected > rejected:
            self._noise_ns, self._trouble = now_ns, _SPOILT
        elif parser.skipped > skipped and not packets:
            if self._trouble != _SPOILT or now_ns - self._noise_ns >= _NOISE_NS:
                self._trouble = "what comes is no MIP packet"
            self._noise_ns = now_ns
        spoilt = min(parser.rejected - rejected, _MOST_REJECTED) if self._identity else 0
        return samples + [self._empty(Status.CRC, now_ns) for _ in range(spoilt)]

    def _answered(self, dialogue: Dialogue, packet: Packet) -> None:
        port = self._config.port
        try:
            dialogue.take(packet)
        except RefusedError as error:
            raise DeviceError(
                self.name,
                f"the sensor cannot be set up: {error}",
                port=port,
                expected="an acknowledgement",
                remedy="update its firmware; switch it off and on",
            ) from None
        except UnsuitableError as error:
            raise DeviceError(
                self.name, str(error), port=port, expected=error.expected, remedy=error.remedy
            ) from None
        if dialogue.result is not None:
            self._finish(dialogue.result)

    def _finish(self, result: SetUp) -> None:
        """The sensor has been set up."""
        self._dialogue, self._is_ours, self._just_set_up = None, True, True
        self.rate_hz = result.rate_hz
        self._heard_ns = self._reported_ns = self._clock.now_ns()
        info = result.info
        self._identity = {
            "model": f.MODELS[info.number],
            "model_number": info.model_number,
            "serial": info.serial or "unknown",
            "firmware": info.firmware_text,
            "rate": f"{result.rate_hz:.1f} Hz",
            "port": self._config.port,
        }

    def _look_after(self, now_ns: int) -> None:
        """Set up anew a sensor that has fallen silent; open a lost port again."""
        if self._port is None:
            if now_ns < self._reopen_ns:
                return
            try:
                self._port = open_port(self._config, self.name)
            except DeviceError as error:
                return self._lose(error, now_ns)
            self._parser.reset()
            self._dialogue, self._is_ours = self._new_dialogue(self._port), False
        if self._dialogue is None and self._silent_for(now_ns, _LOST_NS, _LOST_PERIODS):
            _LOG.warning("%s at %s is silent: set up again", self.name, self._config.port)
            self._dialogue = self._new_dialogue(self._port)
        if self._dialogue is not None:
            self._dialogue.advance(now_ns)

    def _silent_for(self, now_ns: int, least_ns: int, periods: int) -> bool:
        return now_ns - self._heard_ns > max(least_ns, nanoseconds(periods / self.rate_hz))

    def _taken(self, data: f.FilterData, now_ns: int) -> tuple[ImuSample, ...]:
        """Convert a set of filter data to a sample; none until the sensor has been set up."""
        before, self.latest = self.latest, data
        if before is not None and data.device_ns < before.device_ns:
            self._device_clock.reset()
            self._restarted = True
            if not self._just_set_up and self._port is not None:
                _LOG.warning("%s at %s has restarted: set up again", self.name, self._config.port)
                self._dialogue, self._is_ours = self._new_dialogue(self._port), False
        self._just_set_up = False
        t_ns, credible = self._device_clock.map(data.device_ns, now_ns)
        if not self._is_ours:
            return ()
        restarted, self._restarted = self._restarted, False
        self._heard_ns = self._reported_ns = now_ns
        stuck = self._stuck.stuck(data.raw, now_ns)
        status = Status.RESET if restarted else filter_samples.judge(data)
        if status is Status.OK and stuck:
            status = Status.FROZEN
        elif status is Status.OK and not (credible and now_ns - t_ns <= self._stale_ns):
            status = Status.STALE
        if status is not Status.OK:
            self._trouble = f"last status {status.value}"
        if status not in filter_samples.WITH_VALUES:
            return (self._empty(status, now_ns, data.device_ns),)
        return (filter_samples.sample(data, self._stamp(t_ns, now_ns, data.device_ns), status),)

    def _missing(self, now_ns: int) -> tuple[ImuSample, ...]:
        """A sample without values every 20 ms while the sensor is silent or what arrives is noise."""
        if now_ns - self._reported_ns < _REPORT_NS or not self._silent_for(
            now_ns, _SILENT_NS, _SILENT_PERIODS
        ):
            return ()
        self._reported_ns = now_ns
        noise = now_ns - self._noise_ns < _NOISE_NS
        if self._port is not None and not noise:
            self._trouble = "the sensor is silent"
        return (self._empty(Status.PROTOCOL if noise else Status.TIMEOUT, now_ns),)

    def _judge(self, samples: list[ImuSample], now_ns: int) -> None:
        useful = any(s.status is Status.OK for s in samples)
        if overdue_ns := self._silence_timer.overdue_ns(useful, now_ns):
            raise DeviceTimeoutError(
                self.name,
                f"nothing usable for {overdue_ns / NS_PER_S:.1f} s ({self._trouble})",
                port=self._config.port,
                expected=f"{self.rate_hz:.0f} samples per second",
                remedy=REMEDY,
            )

    def _stamp(self, t_ns: int, now_ns: int, device_ns: int | None) -> Stamp:
        self._sequence += 1
        return Stamp(t_ns=t_ns, host_ns=now_ns, seq=self._sequence, device_ns=device_ns)

    def _empty(self, status: Status, now_ns: int, device_ns: int | None = None) -> ImuSample:
        return filter_samples.empty(self._stamp(now_ns, now_ns, device_ns), status)
