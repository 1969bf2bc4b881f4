"""The interfaces of devices, estimators, controllers and sinks. Inherit them explicitly.

Synchronous. A thread may live only inside a driver or a sink. Time, randomness and devices are
arguments. `stop()` on a wall means: wheels at rest, steering held, torque **on**; only `release()`
drops torque.
"""

from __future__ import annotations

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

S_co = TypeVar("S_co", covariant=True)

ReportStop = Callable[[str, str], None]
"""Takes reason and message of a condition under which the robot must not go on."""


class Device(Protocol):
    """Something on the bench with a name that can be opened and closed.

    `open` checks identity and raises `DeviceError` with device, port, expectation and remedy;
    `close` never raises and may be called twice.
    """

    name: str

    @abstractmethod
    def open(self) -> None:
        """Connect and check identity."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the port. Idempotent; never raises."""

    @abstractmethod
    def identity(self) -> Mapping[str, str]:
        """What was found at open: model, firmware, serial number, port. Empty while closed."""


class Sensor(Device, Protocol[S_co]):
    """A device that delivers samples."""

    @abstractmethod
    def read(self) -> tuple[S_co, ...]:
        """All samples since the last call, oldest first.

        A bad sample is returned as data with its status; only persistence raises `DeviceError`.
        Blocks at most for the device's own exchange (a poll), never for the next sample of a stream.
        """


class Actuators(Device, Protocol):
    """The eight servos: sensor and actuator on one bus."""

    @abstractmethod
    def ask(self) -> None:
        """Begin a read, so that other devices can be drained while the bus answers; `read` completes it."""

    @abstractmethod
    def read(self) -> tuple[ServoSample, ...]:
        """One synchronised read of all eight, as a tuple of one sample; begun here if `ask` has not."""

    @abstractmethod
    def read_health(self) -> tuple[ServoHealth, ...]:
        """Voltage and temperature, at the driver's own slow rate, as `read` has come by it; empty between."""

    @abstractmethod
    def enable(self) -> None:
        """Goal := present, watchdog armed, torque on; looked after from now on, even if this fails."""

    @abstractmethod
    def command(self, setpoint: ServoSetpoint) -> None:
        """One sync write of the eight goals."""

    @abstractmethod
    def stop(self) -> None:
        """Wheels at rest, steering held, torque stays on. Never raises."""

    @abstractmethod
    def look_after(self) -> ServoHold:
        """Wheels at rest; what a servo has lost (torque, goals, watchdog) is put right. Never raises.

        From `enable` until `release` or `close` the driver does so by itself when no call talks to it.
        """

    @abstractmethod
    def release(self) -> None:
        """Torque off. On a wall the robot slides: only at the operator's word."""


class Holding(Sensor[S_co], Protocol[S_co]):
    """What keeps the robot on its surface beside its wheels: the fan, the propellers.

    Opening and closing it changes nothing: it goes on with the last command, of whichever program.
    """

    @abstractmethod
    def set_force_n(self, force_n: float) -> None:
        """Ask for a force from now on, reached by a ramp; refused with nothing sent if it cannot be meant.

        Raises:
            UsageError: negative, not finite, or more than the device may give.
        """

    @abstractmethod
    def set_duty(self, duty: float) -> None:
        """Ask for a share of what the device can do, 0..1; as `set_force_n`."""

    def brace(self) -> None:
        """Hold as firmly as it may: the robot is being lost. Never raises."""
        return

    def leave_alone(self, alone: bool) -> None:
        """Send nothing by itself while `alone`, as if the bench had ended; then go on. Never raises.

        So it is seen whether the last command holds the robot without the bench.
        """
        return


class Estimator(Protocol):
    """Pose estimation as a deterministic function of its inputs and its own state."""

    @abstractmethod
    def reset(self, state: RobotState) -> None:
        """Start from a known state."""

    @abstractmethod
    def update(self, measurements: Measurements) -> RobotState:
        """Take one cycle's measurements (late ones rewind) and return the state at `t_ns`."""


class Controller(Protocol):
    """Computes wheel set-points that make the robot track a reference."""

    @abstractmethod
    def reset(self) -> None:
        """Forget integrators and held angles."""

    @abstractmethod
    def update(self, state: RobotState, reference: Reference, wheels: WheelMeasurement) -> WheelSetpoint:
        """Wheel setpoints at the state's time; `wheels` gives the measured steering angles."""


Ask = Callable[[CycleRecord], ExternalCommands]
"""Shows a cycle, before anything is commanded in it, to another program; returns what that commands."""


class ExternalController(Protocol):
    """A controller that is another program: what came of it decides, and is recorded.

    Attributes:
        name: as `--controller` has it.
        ask: gets its commands; a pipeline that nothing is attached to hears none.
        begun: whether there was a command since `reset`; until then nothing moves, and no time passes for the
            reference.
        heard: of the latest cycle.
        warning: what is to be known of the run so far; empty for nothing.
    """

    name: str
    ask: Ask
    begun: bool
    heard: ExternalCommands | None
    warning: str

    @abstractmethod
    def reset(self) -> None:
        """Forget the run."""

    @abstractmethod
    def update(self, seen: CycleRecord, wheels: WheelMeasurement | None) -> WheelSetpoint | None:
        """Setpoint of a cycle; None to rest where the wheels stand.

        Args:
            seen: the cycle; its setpoint and command mean nothing yet.
            wheels: newest aligned wheels; None where none were read.

        Raises:
            SafetyStop: by what it commands, or because it does not.
        """


RUN_NOTE, HELD_NOTE = "run", "held"
"""Kinds of notes between two cycles: how a run begins, and how the bench left the robot."""


class Sink(Protocol):
    """Receives every cycle. `write` never blocks nor raises; what cannot be taken is dropped and counted."""

    @abstractmethod
    def write(self, record: CycleRecord) -> None:
        """Take the record of one cycle."""

    def note(self, t_ns: int, kind: str, data: Mapping[str, object]) -> None:
        """Take a note between two cycles: how a run begins, how the robot was left. Never raises.

        Args:
            t_ns: bench time.
            kind: what it is: `RUN_NOTE`, `HELD_NOTE`, or one of the caller's own.
            data: plain values.
        """
        return

    def objection(self) -> HilError | None:
        """Why the loop must not go on; it asks before every cycle, stops the robot and raises this."""
        return None

    def rest(self) -> None:
        """Called while the loop sleeps until its next cycle: a thread of the sink may work now."""
        return

    @abstractmethod
    def close(self) -> None:
        """Flush and let go. Never raises."""


@runtime_checkable
class CommandingSink(Sink, Protocol):
    """A sink beyond which a program is that commands the robot."""

    @abstractmethod
    def ask(self, seen: CycleRecord) -> ExternalCommands:
        """Show a cycle before anything is commanded in it; waits for an answer, for as long as may be."""
