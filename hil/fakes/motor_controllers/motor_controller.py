"""Motor controller of a fan, for any protocol: power supply, command timeout and physics.

The motor is released `timeout_s` after the last command. The force of the fan goes to the plant; a robot
that the fan has carried once falls when the fan stops.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

import can

from hil.config.adhesion import MotorConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.fakes.body_interface import HoldingForces
from hil.fakes.can_channel import CanChannel, CanFrame
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.motor_controllers.fan_physics import Demand, Fan
from hil.fakes.motor_controllers.forces_on_robot import Load
from hil.fakes.motor_controllers.initial_support import InitialSupport
from hil.fakes.motor_controllers.true_parameters import FanTruthOptions, MotorTruthOptions
from hil.fakes.world import NEVER_NS, Scheduled, World
from hil.faults.fault import Supported
from hil.faults.plan import DeviceFaults

if TYPE_CHECKING:
    from typing_extensions import Self

FAN_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "wrong": ("factor",),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "brownout": (),
    "reset": (),
    "jump": ("speed_rpm",),
    "adhesion_loss": ("factor", "over_s"),
}
_TICK_NS, _QUICK_NS = 20_000_000, 5_000_000
_BOOT_NS = 500_000_000
JUMP_RPM = 5000.0


class MotorNode(Scheduled):
    """Base of emulated motor controllers on a CAN channel.

    Args:
        world: plant, seed and faults; the node registers itself there.
        channel: the CAN bus.
        config: address, and ratings of the fan as the bench file has them.
        options: settings, physics, and true ratings.
        name: device name of its faults.
        load: total force on the robot that this motor is a part of; a load for the fan alone by default.
        motor: index of this motor in `load`.
    """

    Options: ClassVar[type[MotorTruthOptions]] = FanTruthOptions
    supported_faults = FAN_FAULTS
    announces = True

    @classmethod
    def build(cls, request: EmulationRequest, channel: CanChannel) -> Self:
        """Make the controller from its table of the bench file."""
        config = request.config
        return cls(request.world, channel, config, request.options(cls.Options, timeout_s=config.timeout_s))

    def __init__(
        self,
        world: World,
        channel: CanChannel,
        config: MotorConfig,
        options: MotorTruthOptions,
        name: str = "adhesion",
        *,
        load: Load | None = None,
        motor: int = 0,
    ) -> None:
        self.name, self._world, self._channel = name, world, channel
        self._config = config = options.true_ratings(config)
        self._options = options
        known = world.plant.working_point
        point = HoldingForces(config.rated_force_n, 0.0) if known is None else known
        self._load = load or Load(point.adhesion_n, point.fan_gain, world.plant.set_adhesion)
        self._motor = motor
        self.fan = Fan(config, options, self._load.gain)
        stream = f"{name}.{motor}" if motor else name
        self._rng = world.rng(stream)
        self._faults = DeviceFaults(world.faults, name, world.rng(f"{stream}.faults"))
        channel.declare(name, self.supported_faults)
        self._queue = channel.listen(lambda: world.changed(self))
        self._timeout_ns = nanoseconds(options.timeout_s)
        self._commanded_ns = 0
        self._booted_ns = 0
        self._dead = False
        self._turns = 0.0
        self._seen_ns = 0
        self._offset_rpm = 0.0
        phase_ns = int(self._rng.integers(1, _TICK_NS))
        self._tick_ns = phase_ns
        rates = ((options.rate_1_hz, options.messages_1), (options.rate_2_hz, options.messages_2))
        self._due_ns = [phase_ns if rate_hz > 0.0 and which else NEVER_NS for rate_hz, which in rates]
        self._periods_ns = [round(NS_PER_S / rate_hz) if rate_hz > 0.0 else NEVER_NS for rate_hz, _ in rates]
        self.begin("tethered" if options.start == "by use" else options.start)
        world.add(self)

    def begin(self, start: InitialSupport) -> None:
        """Set how the robot is held when the world starts; `running` starts at the working point."""
        self._load.begin(start)
        if start == "running":
            self.fan.begin(self._config.speed_for_rpm(self._load.nominal_n))
        self._press()

    def begin_in_use(self) -> None:
        """Start as a fan that is already running, unless the options say otherwise."""
        self.alone = True  # no part of this world waits for its frames
        if self._options.start == "by use":
            self.begin("running")

    def next_due_ns(self) -> int:
        """Time of the next received frame, status message, command timeout or physics step."""
        due_ns = min(self._tick_ns, self._due_ns[0], self._due_ns[1])
        return min(due_ns, self._queue[0][0]) if self._queue else due_ns

    def on_due(self, t_ns: int) -> None:
        """Integrate the physics, handle received frames, check the timeout, and send due status messages."""
        self._advance(t_ns)
        if not self._faults.none:
            self._power(t_ns)
        while self._queue and self._queue[0][0] <= t_ns:
            self._take(self._queue.popleft()[1], t_ns)
        if self._timeout_ns and t_ns - self._commanded_ns >= self._timeout_ns:
            self.fan.demand = Demand()
        for rate in (0, 1):
            if self._due_ns[rate] <= t_ns:
                self._report(rate, t_ns)
        if self._tick_ns <= t_ns:
            quick = not self.fan.settled or self.fan.strength < 1.0
            self._tick_ns = t_ns + (_QUICK_NS if quick else _TICK_NS)
            if self._timeout_ns and self.fan.demand.mode != "released":
                self._tick_ns = min(self._tick_ns, self._commanded_ns + self._timeout_ns)
        self._press()

    def _advance(self, t_ns: int) -> None:
        """Integrate the physics up to `t_ns`."""
        turns = (t_ns - self._seen_ns) / NS_PER_S * self.fan.speed_rpm / 60.0
        self._turns += turns
        self._seen_ns = t_ns
        self.fan.strength = self._strength(t_ns)
        self.fan.advance(t_ns)

    def _strength(self, t_ns: int) -> float:
        """Share of the motor's power that is left under an `adhesion_loss` fault."""
        fault = self._faults.find("adhesion_loss", t_ns)
        if fault is None:
            return 1.0
        return fault.remaining_share(t_ns, fault.option("factor", 0.0), fault.option("over_s", 0.0))

    def _press(self) -> None:
        self._load.set(self._motor, self.fan.force_n)

    def _power(self, t_ns: int) -> None:
        """Apply `off`, `brownout`, `reset` and `jump`: the motor is free without supply, then it boots."""
        was_dead, self._dead = self._dead, any(self._faults.find(k, t_ns) for k in ("off", "brownout"))
        if self._dead:
            self.fan.demand = Demand()
        elif was_dead or self._faults.first_activation("reset", t_ns):
            self._booted_ns, self.fan.demand = t_ns + _BOOT_NS, Demand()
        if (fault := self._faults.first_activation("jump", t_ns)) is not None:
            self._offset_rpm += fault.option("speed_rpm", JUMP_RPM)

    def _asleep(self, t_ns: int) -> bool:
        return self._dead or t_ns < self._booted_ns

    def _next_report(self, rate: int, t_ns: int) -> None:
        """Schedule the next status messages of one of the two rates."""
        slow = self._faults.find("slow", t_ns)
        self._due_ns[rate] += round(self._periods_ns[rate] * (1.0 if slow is None else slow.period_factor))

    @abstractmethod
    def _take(self, message: CanFrame | can.Message, t_ns: int) -> None:
        """Handle a frame received from the bus."""

    @abstractmethod
    def _report(self, rate: int, t_ns: int) -> None:
        """Send the status messages of one of the two rates and schedule the next ones."""

    def _send(self, frame_id: int, data: bytes, t_ns: int) -> None:
        """Send a frame once for every controller with this id."""
        for _ in range(1 + self._options.twins):
            self._channel.transmit(frame_id, data, t_ns, extended=True, sender=self._queue)
