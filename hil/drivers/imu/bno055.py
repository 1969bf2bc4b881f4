"""BNO055 over UART as a sensor: identity, set-up, burst reads, and repair after a silent chip reset.

One burst per `read` covers gyro, quaternion, linear acceleration, gravity and calibration status
(registers 0x14..0x35, 36 bytes on the wire). A chip that has reset itself answers happily with zeros
in CONFIG mode; the driver notices, restores mode and offsets, and reports `Status.RESET`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

from hil.clock import NS_PER_S, Clock, nanoseconds
from hil.config.imu import ImuConfig
from hil.drivers.imu import burst
from hil.drivers.imu.calibration import SIZE as CALIBRATION_SIZE
from hil.drivers.imu.calibration import ImuCalibration
from hil.drivers.imu.link import ExchangeError, Link
from hil.errors import DeviceError, DeviceTimeoutError
from hil.interfaces import Sensor
from hil.signals import ImuSample, Stamp, Status

_LOG = logging.getLogger(__name__)

_PAGE = 0x07
_REQUEST_BITS = 40.0
_SYS_STATUS, _UNIT_SEL, _OPR_MODE, _TRIGGER = 0x39, 0x3B, 0x3D, 0x3F
_POWER, _AXIS_MAP, _CALIBRATION = 0x3E, 0x41, 0x55
_WITH_STATE = _OPR_MODE + 1 - burst.START
_IDENTITY = bytes((0xA0, 0xFB, 0x32, 0x0F))
_IDENTITY_NAMES = ("chip", "accelerometer", "magnetometer", "gyroscope")
_MODES = {"imu": 0x8, "compass": 0x9, "m4g": 0xA, "ndof_fmc_off": 0xB, "ndof": 0xC}
_TO_CONFIG_S, _TO_FUSION_S = 0.020, 0.008
_SETUP_BUDGET_S = 0.25
_CRYSTAL = 0x80
_SYSTEM_ERROR = 0x01

_OUTAGE_AFTER = 3
_RECHECK_NS = 50_000_000
_WITHOUT_VALUES = (Status.RESET, Status.STARTING)
_IDENTIFY_PERIOD_S = 0.05
_REMEDY = "check power, wiring, baud rate and that the PS1 pin selects UART"


class Bno055Imu(Sensor[ImuSample]):
    """One BNO055.

    Args:
        config: port, mode, mount, budgets.
        clock: the bench clock; every wait and every stamp is on it.
        name: device name in errors and logs.
    """

    def __init__(self, config: ImuConfig, clock: Clock, name: str = "imu") -> None:
        self.name = name
        self._config, self._clock = config, clock
        self._link: Link | None = None
        self._identity: dict[str, str] = {}
        self._mode = _MODES[config.fusion_mode]
        self._calibration: ImuCalibration | None = None
        self._retry_ns = nanoseconds(config.retry_budget_s)
        self._patience_ns = nanoseconds(config.reply_timeout_s)
        self._age_ns = nanoseconds(config.sample_age_s - _REQUEST_BITS / config.baud)
        self._check_ns = nanoseconds(config.check_period_s)
        self._stuck_ns = nanoseconds(config.stuck_after_s)
        self._sequence = 0
        self._length = burst.LENGTH

    def open(self) -> None:
        """Open the port, check the four identity bytes, set up and start the fusion.

        Raises:
            DeviceTimeoutError: nothing answered.
            DeviceError: the port cannot be used or something else answered.
            DataError: the calibration file cannot be used.
        """
        self.close()
        if self._config.calibration_file is not None:
            self._calibration = ImuCalibration.load(self._config.calibration_file)
        self._link = Link(self._config, self._clock, self.name)
        deadline_ns = self._clock.now_ns() + nanoseconds(self._config.open_timeout_s)
        try:
            identity = self._identify(deadline_ns)
            self._set_up(deadline_ns)
        except ExchangeError as error:
            self.close()
            raise self._failure(error, "the BNO055 cannot be set up") from None
        except BaseException:
            self.close()
            raise
        self._identity = identity
        now_ns = self._clock.now_ns()
        self._good_ns = self._changed_ns = now_ns
        self._next_check_ns = now_ns + self._check_ns
        self._checked_ns = self._next_poll_ns = now_ns
        self._failures = self._system_error = 0
        self._was_reset = self._suspicious = False
        self._last_data = b""

    def close(self) -> None:
        """Let go of the port; the chip goes on by itself. Idempotent."""
        self._identity = {}
        if self._link is not None:
            self._link.close()
            self._link = None

    def identity(self) -> Mapping[str, str]:
        """Chip identifiers, firmware and port; empty while closed."""
        return self._identity

    def read(self) -> tuple[ImuSample, ...]:
        """One burst as one sample; empty between the polls of a silent sensor, and while one is under way.

        A burst that was asked ahead takes longer than a cycle of 200 Hz.

        Raises:
            DeviceTimeoutError: nothing usable for `fail_after_s`.
        """
        link = self._opened()
        now_ns = self._clock.now_ns()
        if now_ns < self._next_poll_ns or link.under_way(self._patience_ns):
            return ()
        try:
            if self._suspicious or (now_ns >= self._next_check_ns and not self._config.prefetch):
                self._check(link, now_ns)
                now_ns = self._clock.now_ns()
            budget_ns = 0 if self._failures else self._retry_ns
            data = link.read(burst.START, self._length, now_ns + budget_ns)
            if self._length == _WITH_STATE:
                self._judge_state(data[_SYS_STATUS - burst.START :], now_ns)
        except ExchangeError as error:
            self._length = burst.LENGTH
            return (self._failed(error),)
        self._failures = 0
        sample = self._sample(link, data[: burst.LENGTH])
        if self._config.prefetch:
            self._ask_ahead(link)
        return (sample,)

    def _ask_ahead(self, link: Link) -> None:
        """Request the next burst; when a check is due, up to the registers that a check looks at."""
        due = self._clock.now_ns() >= self._next_check_ns
        self._length = _WITH_STATE if due else burst.LENGTH
        link.ask_ahead(burst.START, self._length)

    def read_calibration(self) -> ImuCalibration:
        """Offsets that the chip has learnt (it leaves the fusion for about 60 ms).

        Raises:
            DeviceError: the chip did not answer as it should.
        """
        link = self._opened()
        try:
            deadline_ns = self._clock.now_ns() + nanoseconds(_SETUP_BUDGET_S)
            self._leave_fusion(link, deadline_ns)
            found = ImuCalibration.from_bytes(link.read(_CALIBRATION, CALIBRATION_SIZE, deadline_ns))
            self._enter_fusion(link, deadline_ns)
        except ExchangeError as error:
            raise self._failure(error, "the calibration cannot be read") from None
        return found

    def write_calibration(self, calibration: ImuCalibration) -> None:
        """Have the chip use these offsets now and after every reset it may have while open.

        Raises:
            DeviceError: the chip did not answer as it should.
        """
        self._calibration = calibration
        self._opened()
        try:
            self._set_up(self._clock.now_ns() + nanoseconds(_SETUP_BUDGET_S))
        except ExchangeError as error:
            raise self._failure(error, "the calibration cannot be written") from None

    def _opened(self) -> Link:
        if self._link is None:
            raise DeviceError(
                self.name, "used while closed", port=self._config.port, remedy="call open() first"
            )
        return self._link

    def _identify(self, deadline_ns: int) -> dict[str, str]:
        """Wait for the chip (it may be booting), then compare the identity bytes."""
        link = self._opened()
        while True:
            now_ns = self._clock.now_ns()
            try:
                link.write(_PAGE, b"\x00", now_ns)
                data = link.read(0x00, 7, now_ns + self._retry_ns)
            except ExchangeError as error:
                if now_ns >= deadline_ns:
                    raise self._failure(error, "no BNO055 answers") from None
            else:
                if data[:4] == _IDENTITY:
                    break
                if now_ns >= deadline_ns:
                    raise self._wrong_identity(data)
            self._clock.sleep_until_ns(now_ns + nanoseconds(_IDENTIFY_PERIOD_S))
        return {
            "model": "BNO055",
            "chip_id": f"0x{data[0]:02X}",
            "firmware": f"{data[5]:x}.{data[4]:02x}",
            "bootloader": f"{data[6]:02x}",
            "port": self._config.port,
        }

    def _wrong_identity(self, data: bytes) -> DeviceError:
        table = ", ".join(
            f"{name} 0x{want:02X} found 0x{have:02X}"
            for name, want, have in zip(_IDENTITY_NAMES, _IDENTITY, data[:4], strict=True)
        )
        return DeviceError(
            self.name,
            "another device answers",
            port=self._config.port,
            expected=table,
            remedy="check the port; the Bosch USB stick speaks another protocol",
        )

    def _set_up(self, deadline_ns: int) -> None:
        """CONFIG mode, units, axes, offsets, then the fusion mode."""
        link = self._opened()
        self._leave_fusion(link, deadline_ns)
        link.write(_POWER, b"\x00", deadline_ns)
        link.write(_UNIT_SEL, b"\x00", deadline_ns)
        if self._config.external_crystal:
            link.write(_TRIGGER, bytes((_CRYSTAL,)), deadline_ns)
        link.write(_AXIS_MAP, bytes((self._config.axis_map, self._config.axis_sign)), deadline_ns)
        if self._calibration is not None:
            link.write(_CALIBRATION, self._calibration.to_bytes(), deadline_ns)
        self._enter_fusion(link, deadline_ns)

    def _leave_fusion(self, link: Link, deadline_ns: int) -> None:
        link.write(_PAGE, b"\x00", deadline_ns)
        link.write(_OPR_MODE, b"\x00", deadline_ns)
        self._wait(_TO_CONFIG_S)

    def _enter_fusion(self, link: Link, deadline_ns: int) -> None:
        link.write(_OPR_MODE, bytes((self._mode,)), deadline_ns)
        self._wait(_TO_FUSION_S)

    def _wait(self, duration_s: float) -> None:
        self._clock.sleep_until_ns(self._clock.now_ns() + nanoseconds(duration_s))

    def _check(self, link: Link, now_ns: int) -> None:
        """Look at mode and system status."""
        state = link.read(_SYS_STATUS, 5, now_ns + (0 if self._failures else self._retry_ns))
        self._judge_state(state, now_ns)

    def _judge_state(self, state: bytes, now_ns: int) -> None:
        """Registers 0x39 to 0x3D; set the chip up again when it has lost its mode."""
        self._suspicious = False
        self._checked_ns, self._next_check_ns = now_ns, now_ns + self._check_ns
        self._system_error = state[1] if state[0] == _SYSTEM_ERROR else 0
        if state[4] & 0x0F != self._mode:
            _LOG.warning("%s at %s has lost its mode: set up again", self.name, self._config.port)
            self._suspicious = True
            self._set_up(now_ns + nanoseconds(_SETUP_BUDGET_S))
            self._suspicious, self._was_reset = False, True

    def _failed(self, error: ExchangeError) -> ImuSample:
        """A sample that says why there is none; raises once the failure has lasted too long."""
        now_ns = self._clock.now_ns()
        self._failures += 1
        self._suspicious = True
        if self._failures >= _OUTAGE_AFTER:
            self._next_poll_ns = now_ns + nanoseconds(self._config.outage_poll_s)
        self._judge(error.status, now_ns, error)
        return self._empty(error.status, now_ns)

    def _judge(self, status: Status, now_ns: int, error: ExchangeError | None = None) -> None:
        if status is Status.OK:
            self._good_ns = now_ns
        elif now_ns - self._good_ns > nanoseconds(self._config.fail_after_s):
            reason = error.reason if error is not None else f"last status {status.value}"
            raise DeviceTimeoutError(
                self.name,
                f"nothing usable for {(now_ns - self._good_ns) / NS_PER_S:.1f} s ({reason})",
                port=self._config.port,
                expected="a burst in every cycle",
                remedy=_REMEDY,
            )

    def _failure(self, error: ExchangeError, what: str) -> DeviceError:
        kind = DeviceTimeoutError if error.status is Status.TIMEOUT else DeviceError
        return kind(
            self.name,
            f"{what} ({error.reason})",
            port=self._config.port,
            expected=f"replies at {self._config.baud} baud",
            remedy=_REMEDY,
        )

    def _stamp(self, host_ns: int, age_ns: int) -> Stamp:
        self._sequence += 1
        return Stamp(t_ns=host_ns - age_ns, host_ns=host_ns, seq=self._sequence)

    def _empty(self, status: Status, now_ns: int) -> ImuSample:
        return burst.empty(self._stamp(now_ns, 0), status)

    def _sample(self, link: Link, data: bytes) -> ImuSample:
        now_ns = self._clock.now_ns()
        counts = burst.unpack(data)
        status = self._status(counts, data, now_ns)
        self._judge(status, now_ns)
        if status in _WITHOUT_VALUES:
            return self._empty(status, now_ns)
        return burst.sample(counts, self._stamp(now_ns, now_ns - link.asked_ns + self._age_ns), status)

    def _status(self, counts: burst.Counts, data: bytes, now_ns: int) -> Status:
        measured = data[: burst.MEASURED]
        if measured != self._last_data:
            self._last_data, self._changed_ns = measured, now_ns
        if self._was_reset:
            self._was_reset = False
            return Status.RESET
        if self._system_error:
            return Status.HARDWARE_ERROR
        status = burst.judge(counts)
        if status is not Status.OK:
            self._suspicious = now_ns - self._checked_ns > _RECHECK_NS
        elif now_ns - self._changed_ns > self._stuck_ns:
            return Status.STALE
        return status
