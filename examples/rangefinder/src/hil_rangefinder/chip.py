"""The emulated TF-Luna: what a client at the other end of the wire sees of one.

It measures the plant's truth: its beam meets a plate that stands across the wall at a known height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hil.fakes.wire import Reply, SerialChip
from hil.fakes.world import NEVER_NS, World
from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.geometry import rotated
from hil_rangefinder import packets as p
from hil_rangefinder.config import LEAST_M, TfLunaConfig
from hil_rangefinder.faulty import SUPPORTED_FAULTS, RangeFaults
from hil_rangefinder.settings import FACTORY, Settings

_VERSION = bytes((4, 3, 1))
_BOOT_NS = nanoseconds(0.3)
_AVERAGING_NS = nanoseconds(0.004)
_ANSWER_NS = nanoseconds(0.001)
_BAUD_TOLERANCE = 0.03
_GAIN_M2 = 100.0 * 8.0**2 / 0.9
"""Strength 100 comes from 8 m on a white target (manual, "Ranging Characteristics")."""
_STRONGEST = 30_000
_CELSIUS = 35.0


@dataclass(frozen=True)
class RangeTruthOptions:
    """What the emulated range finder sees, and what is wrong with it.

    Attributes:
        plate_x_m: where the plate stands, X of the wall frame.
        reflectivity: of the plate; 0.9 is white, 0.1 black.
        scale_sigma, offset_sigma_m: of the errors that stay, drawn by seed.
        noise_m: of one distance at 100 Hz.
        mount_position_m, mount_rotation_wxyz: where the sensor really is in the body; as the table says
            when left out.
    """

    plate_x_m: float = 2.0
    reflectivity: float = 0.9
    scale_sigma: float = 0.003
    offset_sigma_m: float = 0.005
    noise_m: float = 0.003
    mount_position_m: tuple[float, float, float] | None = None
    mount_rotation_wxyz: tuple[float, float, float, float] | None = None


class TfLunaChip(SerialChip):
    """The sensor at the far end of a serial line.

    Args:
        world: truth, seed and faults.
        config: where the bench believes the sensor to be, and the baud rate that it was set to.
        options: true imperfections.
        name: device name, also of its faults.
    """

    def __init__(
        self, world: World, config: TfLunaConfig, options: RangeTruthOptions, name: str = "rangefinder"
    ) -> None:
        self.name, self.supported_faults = name, SUPPORTED_FAULTS
        self._world, self._options = world, options
        self._position_m = options.mount_position_m or config.mount_position_m
        rotation = options.mount_rotation_wxyz or config.mount_rotation_wxyz
        self._beam = tuple(rotated(rotation, (1.0, 0.0, 0.0)))
        self._rng = world.rng(name)
        self._scale = 1.0 + options.scale_sigma * float(self._rng.standard_normal())
        self._offset_m = options.offset_sigma_m * float(self._rng.standard_normal())
        self._bar_code = f"TFL{int(self._rng.integers(10**10)):011d}".encode()
        self._faults = RangeFaults(world.faults, name, self._rng)
        self._saved = self.settings = Settings(baud=config.baud)
        self._client_baud = config.baud
        self._packets = p.Packets()
        self._due_ns = world.now_ns + NS_PER_S // self.settings.rate_hz
        self._silent_until_ns = 0

    def distance_m(self) -> float:
        """True distance along the beam to the plate; infinite where the beam goes elsewhere."""
        x_m, _, theta = self._world.plant.truth().pose_body_in_wall.tolist()
        cos, sin = math.cos(theta), math.sin(theta)
        towards = cos * self._beam[0] - sin * self._beam[1]
        sensor_x_m = x_m + cos * self._position_m[0] - sin * self._position_m[1]
        away_m = self._options.plate_x_m - sensor_x_m
        return away_m / towards if away_m * towards > 0.0 and abs(towards) > 1e-3 else math.inf

    def next_poll_ns(self) -> int:
        """When the next distance is due."""
        return self._due_ns

    def poll(self, t_ns: int) -> list[Reply]:
        """One distance."""
        if self._faults.restarted(t_ns):
            self.reset(t_ns)
        if not self.settings.rate_hz:
            self._due_ns = NEVER_NS
            return []
        period_ns = NS_PER_S / self.settings.rate_hz * self._faults.slowness(t_ns)
        self._due_ns = t_ns + round(period_ns)
        if self._down(t_ns) or not self.settings.output:
            return []
        return self._measure(t_ns)

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Answer commands; at a wrong baud rate, while starting and without power there is silence."""
        self._client_baud = baud
        if self._down(t_ns) or self._misheard():
            self._packets = p.Packets()
            return []
        replies = []
        for packet in self._packets.feed(data):
            if isinstance(packet, p.Answer):
                replies += self._answer(packet, t_ns)
        return replies

    def reset(self, t_ns: int) -> None:
        """Power was cycled: what was not saved is forgotten."""
        self.settings = self._saved
        self._silent_until_ns = t_ns + _BOOT_NS
        self._due_ns = self._silent_until_ns

    def _down(self, t_ns: int) -> bool:
        return t_ns < self._silent_until_ns or self._faults.dead(t_ns)

    def _misheard(self) -> bool:
        return abs(self._client_baud - self.settings.baud) > _BAUD_TOLERANCE * self.settings.baud

    def _measure(self, t_ns: int) -> list[Reply]:
        reading = self._faults.shown(self._reading(t_ns), t_ns)
        data = self._faults.spoil(p.data_packet(reading), t_ns)
        if self._misheard():
            data = self._rng.bytes(len(data))
        ready_ns = t_ns + _AVERAGING_NS + self._faults.delay_ns(t_ns)
        return [Reply(ready_ns, data)] if data else []

    def _reading(self, t_ns: int) -> p.Reading:
        """What the optics see now: distance as the sensor is set to tell it, strength, temperature."""
        true_m = self.distance_m()
        seen, strength_noise = self._rng.standard_normal(2).tolist()
        ideal = _GAIN_M2 * self._options.reflectivity / true_m**2
        strength = round(min(ideal, _STRONGEST) * (1.0 + 0.005 * strength_noise) + strength_noise)
        if true_m < LEAST_M:
            strength = p.OVEREXPOSED
        strength = max(0, self._faults.strength(strength, t_ns))
        if strength < p.WEAK:
            return p.Reading(0, strength, _CELSIUS)
        noise_m = self._options.noise_m * math.sqrt(self.settings.rate_hz / FACTORY.rate_hz) * seen
        told_m = self._scale * true_m + self._offset_m + noise_m + self._faults.offset_m(t_ns)
        told = max(0, min(0xFFFF, round(told_m / self.settings.unit_m)))
        return p.Reading(told, strength, _CELSIUS)

    def _answer(self, packet: p.Answer, t_ns: int) -> list[Reply]:
        if packet.command == p.TRIGGER:
            return self._measure(t_ns) if not self.settings.rate_hz else []
        payload = self._do(packet, t_ns)
        if payload is None:
            return []
        return [Reply(t_ns + _ANSWER_NS, p.command_packet(packet.command, payload))]

    def _do(self, packet: p.Answer, t_ns: int) -> bytes | None:
        """Obey a command; its answer, None for a command that there is not."""
        command, payload = packet
        if command == p.VERSION:
            return _VERSION
        if command == p.BAR_CODE:
            return self._bar_code
        if command == p.RESET:
            self.reset(t_ns)
        elif command == p.RESTORE:
            self.settings = FACTORY
        elif command == p.SAVE:
            self._saved = self.settings
        else:
            taken = self.settings.told(command, payload)
            if taken is None:
                return None
            slept, self.settings = not self.settings.rate_hz, taken
            if slept and taken.rate_hz:
                self._due_ns = t_ns + NS_PER_S // taken.rate_hz
            return taken.shown(command)
        return b"\0"
