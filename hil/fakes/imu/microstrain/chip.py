"""The emulated MicroStrain sensor at the end of a serial line: power, filter, streams, its own clock.

It starts silent (`boot_s`), then answers commands (`emulated_commands`); its filter initialises and runs.
Settings are lost with the power unless they were saved. Data leave `processing_s` after the measurement,
stamped by a clock that runs `clock_ppm` fast. A wrong baud rate gives noise at both ends.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.geometry import Four, Three, conjugated, multiplied, rotated
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.imu.inertial_faults import InertialFaults
from hil.fakes.imu.microstrain.commands import Commands, Settings
from hil.fakes.imu.microstrain.sensing import Fused, MicrostrainTruthOptions, Sensing
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.world import NEVER_NS, World
from hil.faults.fault import Supported
from hil.faults.plan import FaultPlan
from hil.links.mip import fields as f
from hil.links.mip.packets import Field, Packet, PacketParser, encode

__all__ = ["SUPPORTED_FAULTS", "MicrostrainChip"]


SUPPORTED_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "wrong": ("rate_rad_s",),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "brownout": (),
    "reset": (),
    "jump": ("angle_rad",),
}


class MicrostrainFaults(InertialFaults):
    """The active faults of the sensor.

    Options: `wrong,rate_rad_s=` added to every gyro axis; `slow,factor=` stretches the output period;
    `delayed,delay_s=` sends data that much later, with their true stamps; `jump,angle_rad=` turns the
    filter's heading once.
    """

    def __init__(self, plan: FaultPlan, name: str, rng: np.random.Generator) -> None:
        super().__init__(plan, name, rng)
        self._frozen: Fused | None = None

    def distort(self, fused: Fused, t_ns: int) -> Fused:
        """Filter outputs with the active faults applied."""
        if self.find("stuck", t_ns) is not None:
            self._frozen = self._frozen or fused
            return self._frozen
        self._frozen = None
        extra = self.wrong_rate_rad_s(t_ns)
        if not extra:
            return fused
        x, y, z = fused.rate
        return dataclasses.replace(fused, rate=(x + extra, y + extra, z + extra))


_BAUD_TOLERANCE = 0.03
_PATIENCE_NS = 100_000_000
_FIRMWARE = 1007
_STABLE = 1
_HEADING_NS = NS_PER_S


class MicrostrainChip(SerialChip):
    """One sensor, switched on long before the world begins.

    Args:
        world: truth, seed and faults.
        name: device name, also of its faults.
        options: true imperfections.
        mount_rotation_wxyz: sensor axes in the body that the bench assumes.
        baud: baud rate that the sensor is set to.
        model: first digits of its model number.
        saved: settings that it has after power-up.
    """

    Options = MicrostrainTruthOptions

    @classmethod
    def build(cls, request: EmulationRequest) -> MicrostrainChip:
        """The sensor of a table of the bench file."""
        config = request.config
        return cls(
            request.world,
            name=request.kind,
            options=request.options(cls.Options, position_m=config.mount_position_m),
            mount_rotation_wxyz=config.mount_rotation_wxyz,
            baud=config.baud,
        )

    def __init__(
        self,
        world: World,
        *,
        name: str = "imu",
        options: MicrostrainTruthOptions | None = None,
        mount_rotation_wxyz: Four = (0.0, 1.0, 0.0, 0.0),
        baud: int = 115_200,
        model: str = "6286",
        saved: Settings | None = None,
    ) -> None:
        self.name, self.supported_faults = name, SUPPORTED_FAULTS
        self._world, self._baud = world, baud
        self._options = options = options if options is not None else MicrostrainTruthOptions()
        rng = world.rng(name)
        self.sensing = Sensing(options, rng, options.mount_rotation_wxyz or mount_rotation_wxyz)
        serial = f"{model}.{int(rng.integers(1000, 999_999)):06d}"
        info = f.DeviceInfo(
            _FIRMWARE, f.MODELS.get(model, "other"), f"{model}-9960", serial, "I042Y", "8g, 300dps"
        )
        self.commands = Commands(info, options.base_rate_hz, saved if saved is not None else Settings())
        self._parser = PacketParser(_PATIENCE_NS)
        self._faults = MicrostrainFaults(world.faults, name, rng)
        world.faults.declare(name, SUPPORTED_FAULTS)
        self._stretch = 1.0 + 1e-6 * options.clock_ppm
        self._initialisation_ns = nanoseconds(options.initialisation_s)
        self._boot(-nanoseconds(options.boot_s) - self._initialisation_ns - _HEADING_NS)

    def reset(self, t_ns: int) -> None:
        """Reset everything, as a power cycle does."""
        self._boot(t_ns)

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Answer commands; at a wrong baud rate, while starting or without power there is silence."""
        wrong = abs(baud - self._baud) > _BAUD_TOLERANCE * self._baud
        if self._power(t_ns) or wrong:
            self._parser.reset()
            return []
        replies = []
        for packet in self._parser.feed(data, t_ns):
            if answer := self._obey(packet, t_ns):
                replies.append(Reply(t_ns + nanoseconds(self._options.answer_s), answer))
        return replies

    def next_poll_ns(self) -> int:
        """Time of the next measurement; `NEVER_NS` while nothing is to be sent."""
        return self._next_ns

    def poll(self, t_ns: int) -> list[Reply]:
        """Measure, and send the fields that the message format has at this tick of the filter."""
        if t_ns < self._next_ns:
            return []
        tick = self._tick
        self._plan(t_ns)
        if self._power(t_ns) or self.commands.idle:
            return []
        data = self._measured(tick, t_ns)
        ready_ns = t_ns + nanoseconds(self._options.processing_s) + self._faults.lateness_ns(t_ns)
        return [Reply(ready_ns, data)] if data else []

    def _boot(self, t_ns: int) -> None:
        """Power comes on at `t_ns`."""
        self.commands.power_up()
        self._boot_ns = self._filter_ns = t_ns + nanoseconds(self._options.boot_s)
        self._parser.reset()
        self.sensing.restart()
        self._tick = 0
        self._plan(max(self._boot_ns, self._world.now_ns))

    def _power(self, t_ns: int) -> bool:
        """Follow power faults; True while the sensor has no power or is starting."""
        if self._faults.dead or not self._faults.none:
            boot_ns = self._faults.boot_at_ns(t_ns)
            if boot_ns is not None:
                self._boot(boot_ns)
        return self._faults.dead or t_ns < self._boot_ns

    def _obey(self, packet: Packet, t_ns: int) -> bytes:
        """The reply to commands, which take effect at once."""
        commands = self.commands
        before, filter_resets, soft_resets = commands.settings, commands.filter_resets, commands.soft_resets
        reply = commands.answer(packet)
        if commands.settings is not before:
            self._plan(t_ns)
        if commands.filter_resets > filter_resets:
            self._filter_ns = t_ns
            self.sensing.restart()
        if commands.soft_resets > soft_resets:
            self._boot(t_ns)
        return reply

    def _plan(self, t_ns: int) -> None:
        """Schedule the next tick of the filter at which something is sent, counted from the one at `t_ns`."""
        entries = self.commands.sent()
        if not entries:
            self._next_ns = NEVER_NS
            return
        ticks = min(decimation - self._tick % decimation for _, decimation in entries)
        self._tick += ticks
        period_ns = NS_PER_S / self._options.base_rate_hz / self._stretch
        self._next_ns = t_ns + round(ticks * period_ns * self._faults.period_factor(t_ns))

    def _measured(self, tick: int, t_ns: int) -> bytes:
        """The packet of this tick."""
        due = [descriptor for descriptor, decimation in self.commands.sent() if tick % decimation == 0]
        if not due:
            return b""
        settings = self.commands.settings
        self.sensing.heading_error_rad += self._faults.jump_rad(t_ns)
        truth = self._world.plant.truth()
        fused = self._faults.distort(self.sensing.sense(truth, relative=not settings.magnetometer), t_ns)
        fused = _turned(fused, settings.transform_rad)
        state = self._state(t_ns)
        valid = int(state >= f.FIRST_RUNNING_STATE)
        values: dict[int, tuple[float, ...]] = {
            f.REFERENCE_TIME: (max(0, round((t_ns - self._boot_ns) * self._stretch)),),
            f.STATUS: (state, f.DYNAMICS_MODE, _STABLE * valid),
            f.QUATERNION: (*fused.quaternion, valid),
            f.ANGULAR_RATE: (*fused.rate, valid),
            f.LINEAR_ACCELERATION: (*fused.linear, valid),
            f.GRAVITY: (*fused.gravity, valid),
        }
        return encode(f.FILTER_DATA, (Field(key, f.LAYOUTS[key].pack(*values[key])) for key in due))

    def _state(self, t_ns: int) -> int:
        """State of the filter: initialising, vertical gyro, or AHRS once the magnetometer has settled."""
        running_ns = t_ns - self._filter_ns - self._initialisation_ns
        if running_ns < 0:
            return f.FIRST_RUNNING_STATE - 1
        has_heading = self.commands.settings.magnetometer and running_ns > _HEADING_NS
        return f.FIRST_RUNNING_STATE + has_heading


def _turned(fused: Fused, transform_rad: Three) -> Fused:
    """Filter outputs in vehicle axes: the sensor's axes turned by yaw, pitch and roll, in this order."""
    if transform_rad == (0.0, 0.0, 0.0):
        return fused
    roll, pitch, yaw = (0.5 * angle for angle in transform_rad)
    turn = multiplied(
        multiplied((math.cos(yaw), 0.0, 0.0, math.sin(yaw)), (math.cos(pitch), 0.0, math.sin(pitch), 0.0)),
        (math.cos(roll), math.sin(roll), 0.0, 0.0),
    )
    back = conjugated(turn)
    return Fused(
        multiplied(fused.quaternion, turn),
        rotated(back, fused.rate),
        rotated(back, fused.linear),
        rotated(back, fused.gravity),
    )
