"""Driver of a BNO055 over UART: burst reads, their status, and repair after an unannounced chip reset.

One burst per `read` covers gyro, quaternion, linear acceleration, gravity and calibration status
(registers 0x14..0x35, 36 bytes on the wire). A chip that has reset itself answers with zeros in
CONFIG mode; the driver detects that, restores mode and offsets (`bno055_setup`), and reports `Status.RESET`.
"""

import logging
from collections.abc import Mapping

from hil.config.imu import Bno055Config
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.interfaces import Sensor
from hil.core.signals import ImuSample, Stamp, Status
from hil.drivers.imu.bno055 import burst as bno055_burst
from hil.drivers.imu.bno055.calibration import ImuCalibration
from hil.drivers.imu.bno055.messages import ExchangeError, Link
from hil.drivers.imu.bno055.setup import MODES, OPR_MODE, REMEDY, Chip, Repair
from hil.streams.silence_limit import SilenceTimer, used_while_closed
from hil.streams.stuck_values import StuckTest

_LOG = logging.getLogger(__name__)

_REQUEST_BITS = 40.0
_SYS_STATUS = 0x39
_WITH_STATE = OPR_MODE + 1 - bno055_burst.START
_SYSTEM_ERROR = 0x01

_OUTAGE_AFTER = 3
_RECHECK_NS, _LONG_CHECK_NS = 50_000_000, 8_000_000
_OK = Status.OK
_WITHOUT_VALUES = (Status.RESET, Status.STARTING)


class Bno055Imu(Sensor[ImuSample]):
    """One BNO055.

    Args:
        config: port, mode, mount, budgets.
        clock: the bench clock; every wait and every stamp is on it.
    """

    name = "imu"

    @classmethod
    def identify_only(cls, config: Bno055Config, clock: Clock) -> dict[str, str] | None:
        """{} where a BNO055 is at the port, else None. The chip keeps its settings."""
        try:
            link = Link(config, clock, cls.name)
        except DeviceError:
            return None
        try:
            with link.patient():
                end_ns = clock.now_ns() + nanoseconds(config.open_timeout_s)
                Chip(link, config, clock, cls.name, None).identify(end_ns)
        except DeviceError:
            return None
        finally:
            link.close()
        return {}

    def __init__(self, config: Bno055Config, clock: Clock) -> None:
        self._config, self._clock, self._prefetch = config, clock, config.prefetch
        self._link: Link | None = None
        self._identity: dict[str, str] = {}
        self._mode = MODES[config.fusion_mode]
        self._retry_ns = nanoseconds(config.retry_budget_s)
        self._patience_ns = nanoseconds(config.reply_timeout_s)
        self._age_ns = nanoseconds(config.sample_age_s - _REQUEST_BITS / config.baud)
        self._check_ns = nanoseconds(config.check_period_s)
        self._silence_timer = SilenceTimer(config.fail_after_s)
        self._stuck = StuckTest(config.stuck_after_s)
        self._sequence = 0
        self._length = bno055_burst.LENGTH

    def open(self) -> None:
        """Open the port, check the four identity bytes, set up and start the fusion.

        Raises:
            DeviceTimeoutError: nothing answered.
            DeviceError: the port cannot be used or something else answered.
            DataError: the calibration file cannot be used.
        """
        self.close()
        path = self._config.calibration_file
        calibration = None if path is None else ImuCalibration.load(path)
        self._link = link = Link(self._config, self._clock, self.name)
        self._chip = Chip(link, self._config, self._clock, self.name, calibration)
        deadline_ns = self._clock.now_ns() + nanoseconds(self._config.open_timeout_s)
        try:
            with link.patient():
                identity = self._chip.identify(deadline_ns)
                self._chip.prepare(deadline_ns)
        except BaseException:
            self.close()
            raise
        self._identity = identity
        now_ns = self._clock.now_ns()
        self._silence_timer.begin(now_ns)
        self._stuck.reset(now_ns)
        self._next_check_ns = now_ns + self._check_ns
        self._checked_ns = self._next_poll_ns = now_ns
        self._failures = self._system_error = 0
        self._was_reset = self._suspicious = False
        self._repair: Repair | None = None

    def reopen(self) -> None:
        """Open again after an outage: sample numbers go on, and the first sample has status RESET."""
        self.open()
        self._was_reset = True

    @property
    def port_gone(self) -> bool:
        """Whether the port itself has failed in three exchanges in a row."""
        return self._link is not None and self._link.port_failures >= _OUTAGE_AFTER

    def close(self) -> None:
        """Close the port; the chip goes on by itself. Idempotent."""
        self._identity = {}
        if self._link is not None:
            self._link.close()
            self._link = None

    def identity(self) -> Mapping[str, str]:
        """Chip identifiers, firmware and port; empty while closed."""
        return self._identity

    def read(self) -> tuple[ImuSample, ...]:
        """One burst as one sample; empty between the polls of a silent sensor, and while one is under way.

        A burst that was requested ahead takes longer than a cycle of 200 Hz.

        Raises:
            DeviceTimeoutError: nothing usable for `fail_after_s`.
        """
        link = self._opened()
        now_ns = self._clock.now_ns()
        if now_ns < self._next_poll_ns or link.under_way(self._patience_ns):
            return ()
        if self._repair is not None:
            return self._repaired(self._repair, now_ns)
        try:
            if self._suspicious:
                self._check(link, now_ns)
                if self._repair is not None or self._clock.now_ns() - now_ns > _LONG_CHECK_NS:
                    return ()
            budget_ns = 0 if self._failures else self._retry_ns
            data = link.read(bno055_burst.START, self._length, now_ns + budget_ns)
            if self._length == _WITH_STATE:
                self._judge_state(data[_SYS_STATUS - bno055_burst.START :], now_ns)
            self._failures = 0
            sample = self._sample(link, data[: bno055_burst.LENGTH])
        except ExchangeError as error:
            sample = self._failed(error)
        due = self._clock.now_ns() >= self._next_check_ns
        self._length = _WITH_STATE if due else bno055_burst.LENGTH
        if self._prefetch and self._failures < _OUTAGE_AFTER:
            link.ask_ahead(bno055_burst.START, self._length)
        return (sample,)

    def read_calibration(self) -> ImuCalibration:
        """Offsets that the chip has learnt (it leaves the fusion for about 60 ms).

        Raises:
            DeviceError: the chip did not answer as it should.
        """
        self._opened()
        return self._chip.read_offsets()

    def _opened(self) -> Link:
        if self._link is None:
            raise used_while_closed(self.name, self._config.port)
        return self._link

    def _check(self, link: Link, now_ns: int) -> None:
        """Read mode and system status; begin to set up again a chip that says twice that it has another mode.

        Its reply has no checksum: one bit that flips on the way is no lost mode.
        """
        modes = []
        for _ in range(2):
            state = link.read(_SYS_STATUS, 5, now_ns + (0 if self._failures else self._retry_ns))
            self._judge_state(state, now_ns)
            if not self._suspicious:
                return
            modes.append(state[4] & 0x0F)
        if modes[0] != modes[1]:
            return
        _LOG.warning("%s at %s has lost its mode: set up again", self.name, self._config.port)
        self._repair = self._chip.repair()

    def _repaired(self, repair: Repair, now_ns: int) -> tuple[ImuSample, ...]:
        """Go on with setting up the chip: a few writes in a cycle, none of which is waited for."""
        try:
            if repair.go_on(now_ns):
                self._repair, self._suspicious, self._was_reset = None, False, True
        except ExchangeError as error:
            self._repair = None
            return (self._failed(error),)
        self._judge(Status.RESET, now_ns)
        return ()

    def _judge_state(self, state: bytes, now_ns: int) -> None:
        """Evaluate registers 0x39 to 0x3D; a chip in another mode is to be checked."""
        self._checked_ns, self._next_check_ns = now_ns, now_ns + self._check_ns
        self._system_error = state[1] if state[0] == _SYSTEM_ERROR else 0
        self._suspicious = state[4] & 0x0F != self._mode

    def _failed(self, error: ExchangeError) -> ImuSample:
        """A sample without values, with the status of the failure; raises once that has lasted too long."""
        now_ns = self._next_check_ns = self._clock.now_ns()
        self._failures += 1
        if self._failures >= _OUTAGE_AFTER:
            self._next_poll_ns = now_ns + nanoseconds(self._config.outage_poll_s)
        self._judge(error.status, now_ns, error)
        return self._empty(error.status, now_ns)

    def _judge(self, status: Status, now_ns: int, error: ExchangeError | None = None) -> None:
        if overdue_ns := self._silence_timer.overdue_ns(status is _OK, now_ns):
            reason = error.reason if error is not None else f"last status {status.value}"
            raise DeviceTimeoutError(
                self.name,
                f"nothing usable for {overdue_ns / NS_PER_S:.1f} s ({reason})",
                port=self._config.port,
                expected="a burst in every cycle",
                remedy=REMEDY,
            )

    def _stamp(self, host_ns: int, age_ns: int) -> Stamp:
        self._sequence += 1
        return Stamp(host_ns - age_ns, host_ns, self._sequence)

    def _empty(self, status: Status, now_ns: int) -> ImuSample:
        return bno055_burst.empty(self._stamp(now_ns, 0), status)

    def _sample(self, link: Link, data: bytes) -> ImuSample:
        now_ns = self._clock.now_ns()
        counts = bno055_burst.unpack(data)
        status = self._status(counts, data, now_ns)
        self._judge(status, now_ns)
        if status in _WITHOUT_VALUES:
            return self._empty(status, now_ns)
        return bno055_burst.sample(data, self._stamp(now_ns, now_ns - link.asked_ns + self._age_ns), status)

    def _status(self, counts: bno055_burst.Counts, data: bytes, now_ns: int) -> Status:
        stuck = self._stuck.stuck(data[: bno055_burst.MEASURED], now_ns)
        if self._was_reset:
            self._was_reset = False
            return Status.RESET
        if self._system_error:
            return Status.HARDWARE_ERROR
        status = bno055_burst.judge(counts)
        if status is not _OK:
            self._suspicious = now_ns - self._checked_ns > _RECHECK_NS
        elif stuck:
            return Status.FROZEN
        return status
