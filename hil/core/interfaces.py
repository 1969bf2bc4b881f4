"""The interfaces of devices, estimators, controllers and sinks. Inherit them explicitly.

Synchronous. A thread may live only inside a driver or a sink. Time, randomness and devices are
arguments. `stop()` on a wall means: wheels at rest, steering held, torque **on**; only `release()`
drops torque.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Protocol, TypeVar, runtime_checkable

from hil.core.errors import HilError
from hil.core.external_commands import ExternalCommands
from hil.core.signals import (
    CycleRecord,
    Measurements,
    Reference,
    RobotState,
    ServoHealth,
    ServoHold,
    ServoSample,
    ServoSetpoint,
    WheelMeasurement,
    WheelSetpoint,
)
from hil.core.watched_robot import WatchedRobot

S_co = TypeVar("S_co", covariant=True)

ReportStop = Callable[[str, str], None]
"""Takes reason and message of a condition under which the robot must not go on."""


class Device(Protocol):
    """A named device of the bench that can be opened and closed.

    `open` checks identity and raises `DeviceError` with device, port, expectation and remedy;
    `close` never raises and may be called twice.
    """

    name: str

    @abstractmethod
    def open(self) -> None:
        """Connect and check identity."""

    @abstractmethod
    def close(self) -> None:
        """Release the port. Idempotent; never raises."""

    @abstractmethod
    def identity(self) -> Mapping[str, str]:
        """Identity read at open: model, firmware, serial number, port. Empty while closed."""


class Sensor(Device, Protocol[S_co]):
    """A device that delivers samples."""

    @abstractmethod
    def read(self) -> tuple[S_co, ...]:
        """All samples since the last call, oldest first.

        A bad sample is returned with its status; only a lasting failure raises `DeviceError`.
        Blocks at most for one request and reply (a poll), never for the next sample of a stream.
        """


class Actuators(Device, Protocol):
    """The eight servos: sensor and actuator on one bus."""

    @abstractmethod
    def ask(self) -> None:
        """Send a read request, so that other devices can be read while the bus answers; `read` ends it."""

    @abstractmethod
    def read(self) -> tuple[ServoSample, ...]:
        """One synchronised read of all eight servos, as a tuple of one sample; begun here unless by `ask`."""

    @abstractmethod
    def read_health(self) -> tuple[ServoHealth, ...]:
        """Voltage and temperature that `read` collected, at the driver's slow rate; empty in between."""

    @abstractmethod
    def enable(self) -> None:
        """Set goal := present, arm watchdogs, torque on; kept alive from now on, even after an error."""

    @abstractmethod
    def command(self, setpoint: ServoSetpoint) -> None:
        """One sync write of the eight goals."""

    @abstractmethod
    def stop(self) -> None:
        """Wheels at rest, steering held, torque stays on. Never raises."""

    @abstractmethod
    def look_after(self) -> ServoHold:
        """Keep wheels at rest; restore what a servo has lost (torque, goals, watchdog). Never raises.

        From `enable` until `release` or `close` the driver also does this by itself when no calls come.
        """

    @abstractmethod
    def release(self) -> None:
        """Switch torque off. On a wall the robot slides: only on the operator's command."""


class Holding(Sensor[S_co], Protocol[S_co]):
    """A device that keeps the robot on its surface besides the wheels: the fan, the propellers.

    Opening and closing it changes nothing: it continues with the last command of any program.
    """

    @abstractmethod
    def set_force_n(self, force_n: float) -> None:
        """Set the force set-point, reached by a ramp; an invalid one is refused and nothing is sent.

        Raises:
            UsageError: negative, not finite, or more than the device may give.
        """

    @abstractmethod
    def set_duty(self, duty: float) -> None:
        """Set the duty, 0..1 of full output; otherwise as `set_force_n`."""

    def brace(self) -> None:
        """Raise the force to the permitted maximum, because the robot is losing its hold. Never raises."""
        return

    def leave_alone(self, alone: bool) -> None:
        """Send nothing while `alone`, as if the bench had ended; resume afterwards. Never raises.

        This shows whether the last command holds the robot without the bench.
        """
        return


class Estimator(Protocol):
    """Pose estimation as a deterministic function of its inputs and its own state."""

    @abstractmethod
    def reset(self, state: RobotState) -> None:
        """Restart the estimator from a known state."""

    @abstractmethod
    def update(self, measurements: Measurements) -> RobotState:
        """Process one cycle's measurements (late ones rewind the filter) and return the state at `t_ns`."""


class Controller(Protocol):
    """Computes wheel set-points that make the robot track a reference."""

    @abstractmethod
    def reset(self) -> None:
        """Clear integrators and held steering angles."""

    @abstractmethod
    def update(self, state: RobotState, reference: Reference, wheels: WheelMeasurement) -> WheelSetpoint:
        """Compute wheel setpoints at the state's time; `wheels` gives the measured steering angles."""


Ask = Callable[[CycleRecord], ExternalCommands]
"""Sends a cycle to another program before the cycle is commanded; returns the commands of that program."""


class ExternalController(Protocol):
    """A controller in another program; the commands received from it are used and recorded.

    Attributes:
        name: value of `--controller`.
        ask: function that gets its commands; returns none in a pipeline without a connection.
        begun: True once a command has arrived since `reset`; until then nothing moves, and the time of the
            reference stands still.
        heard: commands of the latest cycle.
        warning: warning about the run so far; empty for none.
    """

    name: str
    ask: Ask
    begun: bool
    heard: ExternalCommands | None
    warning: str

    @abstractmethod
    def reset(self) -> None:
        """Clear the state of the run."""

    @abstractmethod
    def update(self, seen: CycleRecord, wheels: WheelMeasurement | None) -> WheelSetpoint | None:
        """Setpoint of a cycle; None to hold the wheels where they are.

        Args:
            seen: the cycle; its setpoint and command are not set yet.
            wheels: newest aligned wheels; None where none were read.

        Raises:
            SafetyStop: its command is not permitted, or missing.
        """


RUN_NOTE, HELD_NOTE = "run", "held"
"""Kinds of notes between two cycles: how a run begins, and how the bench left the robot."""


class Sink(Protocol):
    """Receives every cycle. `write` never blocks or raises; records it cannot take are dropped, counted."""

    @abstractmethod
    def write(self, record: CycleRecord) -> None:
        """Process the record of one cycle."""

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Record a note between two cycles: how a run begins, how the robot was left. Never raises.

        Args:
            t_ns: bench time.
            kind: `RUN_NOTE`, `HELD_NOTE`, or one of the caller's own.
            data: plain values.
        """
        return

    def watched(self, robot: WatchedRobot) -> None:
        """Take what is seen of the robot while it is watched without a loop. Never blocks or raises."""
        return

    def objection(self) -> HilError | None:
        """Error because of which the loop must not continue; else None.

        The loop checks it before every cycle, stops the robot and raises it.
        """
        return None

    def rest(self) -> None:
        """Called while the loop sleeps until its next cycle: a thread of the sink may work now."""
        return

    @abstractmethod
    def close(self) -> None:
        """Flush and release resources. Never raises."""


@runtime_checkable
class CommandingSink(Sink, Protocol):
    """A sink that connects to a program which commands the robot."""

    @abstractmethod
    def ask(self, seen: CycleRecord) -> ExternalCommands:
        """Send a cycle before it is commanded, and wait for the answer up to the permitted time."""
