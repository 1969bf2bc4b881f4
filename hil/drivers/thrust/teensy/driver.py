"""Driver of the propellers behind a Teensy: lines `THR<0..180>`, which are not acknowledged.

Opening the port changes nothing. Once a throttle was commanded it is repeated, so that a lost line, the
firmware's ramp down after a damaged line, and a restart do not last. `read` repeats it; without reads, after
a stop or between motions, a timer of the driver does. Each write carries the line several times: the rest of
one that was cut spoils the first copy only, and what counts once the bench is silent is the last whole line.
"""

import logging
import math
import threading
from collections.abc import Callable, Mapping
from typing import Any

from hil.config.thrust import STEPS, TeensyConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceTimeoutError, UsageError
from hil.core.interfaces import Holding
from hil.core.signals import Stamp, Status, ThrustSample
from hil.links.serial_url import PORT_ERRORS, cannot_open, close_quietly, open_serial
from hil.streams.silence_limit import used_while_closed

_LOG = logging.getLogger(__name__)

_SLACK_NS = 1_000_000
_COPIES = 8
"""Number of lines in a write, which fits into a USB packet of 64 bytes."""
_ALONE = 1.2
"""Multiple of the period after which a throttle is sent again without reads."""


class TeensyThrust(Holding[ThrustSample]):
    """All propellers, by one throttle.

    Args:
        config: port and full force.
        clock: the bench clock.

    Attributes:
        bears: faults of the wire that change nothing: a flipped bit spoils one of the copies of a line.
    """

    name = "thrust"
    bears = ("corrupt",)

    def __init__(self, config: TeensyConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._port: Any = None
        self._identity: dict[str, str] = {}
        self._repeat_ns = nanoseconds(config.repeat_s)
        self._step: int | None = None
        self._next_ns = self._failing_ns = self._sent_ns = 0
        self._sequence = 0
        self._talking = threading.Lock()
        self._end: Callable[[], None] | None = None
        self._reported = self._alone = False

    def open(self) -> None:
        """Open the port; raises `DeviceError`. Whether a Teensy receives the lines cannot be checked."""
        self.close()
        config = self._config
        try:
            self._port = open_serial(
                config.port,
                baud=config.baud,
                timeout_s=0.0,
                write_timeout_s=config.write_timeout_s,
                shared=True,
            )
        except PORT_ERRORS as error:
            expected = "the Teensy of the propellers at a serial port or pyserial URL"
            raise cannot_open(self.name, config.port, error, expected=expected) from None
        self._next_ns = self._clock.now_ns()
        self._failing_ns, self._step, self._alone = 0, None, False
        self._identity = {"model": "Teensy", "port": config.port, "baud": str(config.baud)}

    def close(self) -> None:
        """Close the port; the propellers go on. Idempotent; never raises."""
        if self._end is not None:
            self._end()
            self._end = None
        self._identity, self._next_ns = {}, 0
        with self._talking:
            port, self._port = self._port, None
        close_quietly(port)

    def identity(self) -> Mapping[str, str]:
        """Model, port and baud rate; empty while closed."""
        return self._identity

    def read(self) -> tuple[ThrustSample, ...]:
        """Send the throttle again where it is due; one sample each time.

        Raises:
            DeviceTimeoutError: the port has taken nothing for half a second.
        """
        now_ns = self._clock.now_ns()
        if now_ns < self._next_ns - _SLACK_NS:
            return ()
        self._must_be_open()
        self._next_ns = max(self._next_ns + self._repeat_ns, now_ns - self._repeat_ns)
        sent = self._alone or self._step is None or self._send(self._step)
        status = Status.OK if sent else Status.TIMEOUT
        throttle = math.nan if self._step is None or status is not Status.OK else self._step / STEPS
        self._sequence += 1
        return (ThrustSample(Stamp(now_ns, now_ns, self._sequence), throttle, math.nan, status),)

    def set_force_n(self, force_n: float) -> None:
        """Command a force; raises `UsageError` for one that no throttle gives."""
        self._config.check_force(force_n, self.name)
        self.set_duty(self._config.throttle_for(force_n))

    def set_duty(self, duty: float) -> None:
        """Command a throttle 0..1; raises `UsageError`, or `DeviceError` where the port takes nothing."""
        if not (math.isfinite(duty) and 0.0 <= duty <= 1.0):
            raise UsageError(
                f"{self.name}: a throttle of {duty:g}", expected="0 to 1", remedy="a share of full throttle"
            )
        self._must_be_open()
        self._step = round(STEPS * duty)
        self._send(self._step)
        if self._end is None:
            self._end = self._clock.schedule(self._repeat, self._due_ns())

    def leave_alone(self, alone: bool) -> None:
        """Do not repeat the throttle while `alone`: the firmware goes on with the last one."""
        self._alone = alone

    def _due_ns(self) -> int:
        """Time at which the timer sends the throttle if no read has."""
        return self._sent_ns + round(_ALONE * self._repeat_ns)

    def _repeat(self, now_ns: int) -> int:
        """Send the throttle again if no read has; returns the time of the next check."""
        if now_ns >= self._due_ns() and self._step is not None and not self._alone:
            try:
                if self._send(self._step):
                    self._reported = False
            except DeviceTimeoutError as error:
                if not self._reported:
                    _LOG.warning("while no caller read: %s", error)
                self._reported = True
        return max(self._due_ns(), now_ns + self._repeat_ns // 2)

    def _send(self, step: int) -> bool:
        now_ns = self._sent_ns = self._clock.now_ns()
        try:
            with self._talking:
                if self._port is None:
                    return False
                self._port.write(b"THR%d\n" % step * _COPIES)
        except PORT_ERRORS as error:
            self._failing_ns = self._failing_ns or now_ns
            if now_ns - self._failing_ns > nanoseconds(0.5):
                raise DeviceTimeoutError(
                    self.name,
                    f"the port takes nothing ({error}): the propellers go on as last commanded",
                    port=self._config.port,
                    expected="a port that takes a line",
                    remedy="plug it in again; secure the robot first",
                ) from None
            return False
        self._failing_ns = 0
        return True

    def _must_be_open(self) -> None:
        if self._port is None:
            raise used_while_closed(self.name, self._config.port)
