"""The Teensy that drives the propellers' speed controllers: lines `THR<0..180>` in, pulses out, no reply.

The number is in steps of a servo library: 0 is a pulse of 1000 us, 180 of 2000 us. After an error (an invalid
line or a number out of range) it reduces the throttle by one step every 100 ms until the next valid line.
Without lines it keeps the last throttle.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import ClassVar

from hil.config.thrust import TeensyConfig
from hil.core.clock import NS_PER_S
from hil.fakes.body_interface import HoldingForces
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.motor_controllers.initial_support import InitialSupport, Tether
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.thrust.teensy.true_parameters import ThrustTruthOptions
from hil.fakes.world import World
from hil.faults.fault import OUT, Option, Supported
from hil.faults.plan import DeviceFaults

THRUST_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": (),
    "wrong": ("factor",),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "brownout": (),
    "reset": (),
    "jump": ("steps",),
}
STEPS = 180
_LINE = re.compile(rb"THR(\d{1,3})\r?")
_MOST_BYTES = 64
_STEP_DOWN_NS = 100_000_000
_TICK_NS, _AWAKE_NS, _QUICK_NS = 500_000_000, 20_000_000, 5_000_000
"""While nothing changes; while a fault may begin; while the force changes."""
_WRONG, _DELAY_S = 0.5, 0.3
_SETTLED = 1e-3


class TeensyChip(SerialChip):
    """Firmware, speed controllers and propellers.

    Args:
        world: plant, seed and faults.
        config: configuration of the propellers.
        options: true imperfections.
        name: device name of its faults.

    Attributes:
        step: present throttle of the controllers, 0..180.
        force_n: force of all propellers.
    """

    Options = ThrustTruthOptions
    supported_faults = THRUST_FAULTS
    fault_ranges: ClassVar[Mapping[str, Option]] = {
        "wrong:factor": Option("of the propellers' force; none pulls", 0, 10)
    }
    polls_alone = True
    ways = OUT

    @classmethod
    def build(cls, request: EmulationRequest) -> TeensyChip:
        """Make the firmware from its table of the bench file."""
        return cls(request.world, request.config, request.options(cls.Options))

    def __init__(
        self, world: World, config: TeensyConfig, options: ThrustTruthOptions, name: str = "thrust"
    ) -> None:
        self.name, self._world, self._options = name, world, options
        self._config = options.true_ratings(config)
        known = world.plant.working_point
        self._point = HoldingForces(0.0, 0.0) if known is None else known
        self._faults = DeviceFaults(world.faults, name, world.rng(f"{name}.faults"))
        self._line = bytearray()
        self._waiting: list[tuple[int, int]] = []
        self._failed = self._dead = False
        self._step_down_ns = 0
        self._seen_ns = 0
        self.step, self.force_n = 0, 0.0
        self._tick_ns = _TICK_NS
        self.begin("tethered" if options.start == "by use" else options.start)

    def begin(self, start: InitialSupport) -> None:
        """Set how the robot is held when the world starts."""
        self._tether = Tether(start, self._point.thrust_n)
        if start == "running":
            nominal_n = self._point.thrust_n / self._point.propeller_gain
            self.step = min(STEPS, round(STEPS * self._config.throttle_for(nominal_n)))
            self.force_n = self._aim_n(0)
        self._push()

    def begin_in_use(self) -> None:
        """Start with a throttle that is already set, unless the options say otherwise."""
        if self._options.start == "by use":
            self.begin("running")

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Parse lines; at another baud rate they are invalid."""
        self._advance(t_ns)
        if self._dead:
            return []
        noise = self._faults.find("garbage", t_ns) is not None or abs(baud / self._config.baud - 1.0) > 0.03
        for byte in data:
            if byte == ord("\n"):
                self._take(bytes(self._line) if not noise else b"?", t_ns)
                self._line.clear()
            elif len(self._line) < _MOST_BYTES:
                self._line.append(byte)
        if noise and data:
            self._take(b"?", t_ns)
        self._push()
        return []

    def reset(self, t_ns: int) -> None:
        """Power was cycled: no pulses until the next valid line."""
        self._line.clear()
        self._waiting.clear()
        self.step, self._failed = 0, False

    def poll(self, t_ns: int) -> list[Reply]:
        """Step the physics, and reduce the throttle after an error."""
        self._advance(t_ns)
        while self._waiting and self._waiting[0][0] <= t_ns:
            self.step = self._waiting.pop(0)[1]
        if self._failed and self.step and t_ns >= self._step_down_ns:
            self.step -= 1
            self._step_down_ns += _STEP_DOWN_NS
        settled = abs(self._aim_n(t_ns) - self.force_n) < _SETTLED * self._config.full_force_n
        calm_ns = _TICK_NS if self._world.faults.empty else _AWAKE_NS
        self._tick_ns = t_ns + (calm_ns if settled else _QUICK_NS)
        self._push()
        return []

    def next_poll_ns(self) -> int:
        """Time of the next physics step or change of the throttle."""
        changes_ns = [due_ns for due_ns, _ in self._waiting[:1]]
        if self._failed and self.step:
            changes_ns.append(self._step_down_ns)
        return min([self._tick_ns, *changes_ns])

    def _take(self, line: bytes, t_ns: int) -> None:
        match = _LINE.fullmatch(line)
        step = int(match[1]) if match else -1
        if not 0 <= step <= STEPS:
            if not self._failed:
                self._failed, self._step_down_ns = True, t_ns + _STEP_DOWN_NS
            return
        self._failed = False
        if self._faults.find("stuck", t_ns) is not None:
            return
        delayed = self._faults.find("delayed", t_ns)
        if delayed is not None:
            self._waiting.append((t_ns + delayed.delay_ns(_DELAY_S), step))
        else:
            self.step = step
        self._tick_ns = min(self._tick_ns, t_ns + _QUICK_NS)

    def _advance(self, t_ns: int) -> None:
        dt_s, self._seen_ns = (t_ns - self._seen_ns) / NS_PER_S, t_ns
        if not self._faults.none:
            self._power(t_ns)
        slow = self._faults.find("slow", t_ns)
        lag_s = self._options.lag_s * (1.0 if slow is None else slow.period_factor)
        aim_n = self._aim_n(t_ns)
        self.force_n = aim_n + (self.force_n - aim_n) * math.exp(-dt_s / lag_s)

    def _power(self, t_ns: int) -> None:
        was_dead, self._dead = self._dead, any(self._faults.find(k, t_ns) for k in ("off", "brownout"))
        if (self._dead and not was_dead) or self._faults.first_activation("reset", t_ns):
            self.reset(t_ns)
        if (fault := self._faults.first_activation("jump", t_ns)) is not None:
            self.step = min(max(self.step + round(fault.option("steps", -20)), 0), STEPS)

    def _aim_n(self, t_ns: int) -> float:
        """Steady-state force at the present throttle."""
        wrong = self._faults.find("wrong", t_ns)
        factor = 1.0 if wrong is None else wrong.option("factor", _WRONG)
        return factor * self._point.propeller_gain * self._config.force_at_n(self.step / STEPS)

    def _push(self) -> None:
        self._world.plant.set_thrust(self._tether.force_n(self.force_n))
