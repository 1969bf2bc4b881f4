"""The emulated TF-Luna: its beam meets a plate that stands across the wall at a known height."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from hil.devkit.chip import EmulationRequest, SerialStreamingChip, rotated
from hil_rangefinder import LEAST_M
from hil_rangefinder import protocol as p

_VERSION, _CELSIUS, _STRONGEST = bytes((4, 3, 1)), 35.0, 30_000
_GAIN_M2 = p.WEAK * 8.0**2 / 0.9
"""Strength 100 comes from 8 m on a white target (manual, "Ranging Characteristics")."""
_FACTORY = {p.RATE: b"\x64\0", p.FORMAT: b"\x01", p.BAUD: struct.pack("<I", 115_200), p.OUTPUT: b"\x01"}


@dataclass(frozen=True)
class RangeTruthOptions:
    """What the emulated range finder sees, and what is wrong with it.

    Attributes:
        plate_x_m: where the plate stands, X of the wall frame.
        reflectivity: of the plate; 0.9 is white, 0.1 black.
        scale_sigma, offset_sigma_m: of the errors that stay, drawn by seed.
        noise_m: of one distance at 100 Hz.
        mount_position_m, mount_rotation_wxyz: where the sensor really is; as the table says when left out.
    """

    plate_x_m: float = 2.0
    reflectivity: float = 0.9
    scale_sigma: float = 0.003
    offset_sigma_m: float = 0.005
    noise_m: float = 0.003
    mount_position_m: tuple[float, float, float] | None = None
    mount_rotation_wxyz: tuple[float, float, float, float] | None = None


class TfLunaChip(SerialStreamingChip):
    """The sensor. Own faults: `wrong,offset_m=` or `strength=`; `jump,offset_m=`: something in the beam."""

    Options = RangeTruthOptions
    own_faults = {"wrong": ("offset_m", "strength"), "jump": ("offset_m",)}  # noqa: RUF012
    delay_s = 0.004

    def __init__(self, request: EmulationRequest) -> None:
        super().__init__(request)
        self._position_m = self.options.mount_position_m or self.config.mount_position_m
        rotation = self.options.mount_rotation_wxyz or self.config.mount_rotation_wxyz
        self._beam = tuple(rotated(rotation, (1.0, 0.0, 0.0)))
        self._scale = 1.0 + self.options.scale_sigma * float(self.rng.standard_normal())
        self._offset_m = self.options.offset_sigma_m * float(self.rng.standard_normal())
        self._bar_code = f"TFL{int(self.rng.integers(10**10)):011d}".encode()
        self._saved = {**_FACTORY, p.BAUD: struct.pack("<I", self.config.baud)}
        self.restart(0)

    def restart(self, t_ns: int) -> None:
        """What was not saved is forgotten."""
        self._parser = p.parser()
        self._apply(dict(self._saved))

    def distance_m(self) -> float:
        """True distance along the beam to the plate; infinite where the beam goes elsewhere."""
        x_m, _, theta = self.world.plant.truth().pose_body_in_wall.tolist()
        cos, sin = math.cos(theta), math.sin(theta)
        towards = cos * self._beam[0] - sin * self._beam[1]
        away_m = self.options.plate_x_m - x_m - cos * self._position_m[0] + sin * self._position_m[1]
        return away_m / towards if away_m * towards > 0.0 and abs(towards) > 1e-3 else math.inf

    def measure(self, t_ns: int) -> p.Reading:
        """Distance as the sensor is set to report it, strength, temperature."""
        true_m = self.distance_m()
        noise, flicker = self.rng.standard_normal(2).tolist()
        echo = min(_GAIN_M2 * self.options.reflectivity / true_m**2, _STRONGEST)
        echo = max(0, round(echo * (1.0 + 0.005 * flicker) + flicker))
        strength = p.OVEREXPOSED if true_m < LEAST_M else int(echo)
        offset_m = self._offset_m + self.options.noise_m * math.sqrt(self.rate_hz / 100.0) * noise
        offset_m -= self.fault_option("jump", "offset_m", 0.5)
        wrong = self.fault("wrong", t_ns)
        if wrong is not None and "strength" in wrong.options:
            strength = int(min(max(wrong.options["strength"], 0.0), 65535.0))
        else:
            offset_m += self.fault_option("wrong", "offset_m", 0.1)
        if strength < p.WEAK:
            return p.Reading(0, strength, _CELSIUS)
        counts = round((self._scale * true_m + offset_m) / self._unit_m)
        return p.Reading(min(max(counts, 0), 0xFFFF), strength, _CELSIUS)

    def encode(self, measured: p.Reading) -> bytes:
        """Nine bytes."""
        return measured.packet()

    def answer(self, data: bytes, t_ns: int) -> bytes:
        """Obey and answer commands."""
        commands = [packet for packet in self._parser.feed(data) if isinstance(packet, p.Command)]
        answers = [(command.code, self._obey(command, t_ns)) for command in commands]
        return b"".join(p.Command(code, payload).packet() for code, payload in answers if payload is not None)

    def _obey(self, command: p.Command, t_ns: int) -> bytes | None:
        """Payload of the answer; None for a command that there is not."""
        code, payload = command
        known = {p.VERSION: _VERSION, p.BAR_CODE: self._bar_code}
        if code in known:
            return known[code]
        if code in self._settings:
            if len(payload) == len(self._settings[code]) and p.is_possible(code, payload):
                self._apply({**self._settings, code: payload})
            return self._settings[code]
        if code == p.RESET:
            self.reset(t_ns)
        elif code == p.SAVE:
            self._saved = dict(self._settings)
        elif code == p.RESTORE:
            self._apply(dict(_FACTORY))
        else:
            return None
        return b"\0"

    def _apply(self, settings: dict[int, bytes]) -> None:
        asleep, self._settings = not self.rate_hz, settings
        self.uart_baud = int.from_bytes(settings[p.BAUD], "little")
        self.rate_hz = int.from_bytes(settings[p.RATE], "little") * settings[p.OUTPUT][0]
        self._unit_m = dict(p.UNITS.values())[settings[p.FORMAT]]
        if asleep and self.rate_hz:
            self.wake()
