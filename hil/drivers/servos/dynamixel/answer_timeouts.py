"""Measures how long each servo has not answered, and raises the error once that is too long."""

from collections.abc import Sequence

from hil.config.servo_models.x_series_codes import hardware_error_text
from hil.config.servos import ServosConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import SERVOS, Status
from hil.drivers.servos.dynamixel.cyclic_read import ALL_OK
from hil.streams.silence_limit import is_pause


class AnswerTimeouts:
    """Records when each servo was last usable. A pause in reading counts for none, whatever else was sent.

    Args:
        config: IDs, and `fail_after_s`.
        device: name in errors.
        now_ns: time at which the watch begins: all count as usable then.
    """

    def __init__(self, config: ServosConfig, device: str, now_ns: int) -> None:
        self._config, self._device = config, device
        self._limit_ns = nanoseconds(config.fail_after_s)
        self._good_ns = [now_ns] * len(SERVOS)
        self._read_ns, self._gap_ns = now_ns, 0

    def skip_pause(self, silence_ns: int) -> None:
        """Leave out `silence_ns` without requests, in which no servo failed to answer."""
        self._read_ns += silence_ns
        self._good_ns = [good_ns + silence_ns for good_ns in self._good_ns]

    def record(self, status: tuple[Status, ...], now_ns: int) -> bool:
        """Record which servos were usable at `now_ns`; returns whether all were."""
        before_ns, self._gap_ns, self._read_ns = self._gap_ns, now_ns - self._read_ns, now_ns
        if status is ALL_OK:
            self._good_ns = [now_ns] * len(SERVOS)
            return True
        if is_pause(self._gap_ns, before_ns):
            self._good_ns = [good_ns + self._gap_ns for good_ns in self._good_ns]
        for j, one in enumerate(status):
            if one is Status.OK:
                self._good_ns[j] = now_ns
        return False

    def note(self, status: tuple[Status, ...], alert: Sequence[int], now_ns: int) -> None:
        """Take the outcome of a read.

        Args:
            status: status of each servo.
            alert: Hardware Error Status per servo.
            now_ns: time at which it had arrived.

        Raises:
            DeviceTimeoutError: a servo has not answered usably for `fail_after_s`.
            DeviceError: a servo has reported a hardware error for `fail_after_s`.
        """
        if self.record(status, now_ns):
            return
        late = [j for j in range(len(SERVOS)) if now_ns - self._good_ns[j] > self._limit_ns]
        if late:
            raise self._failure(late, status, alert)

    def _failure(self, late: list[int], status: tuple[Status, ...], alert: Sequence[int]) -> DeviceError:
        found = ", ".join(
            f"{SERVOS[j]} (ID {self._config.ids[j]}): {status[j].value}"
            + (f" {hardware_error_text(alert[j])}" if alert[j] else "")
            for j in late
        )
        broken = any(status[j] is Status.HARDWARE_ERROR for j in late)
        return (DeviceError if broken else DeviceTimeoutError)(
            self._device,
            f"nothing usable for {self._limit_ns / NS_PER_S:g} s from {found}",
            port=self._config.port,
            expected="an answer in every cycle",
            remedy="remove the cause, then reboot the servo" if broken else "check cable, power and IDs",
        )
