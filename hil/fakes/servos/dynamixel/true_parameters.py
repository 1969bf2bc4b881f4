"""True parameters of an emulated servo bus: IDs, EEPROM, supply, temperature, behaviour of the firmware."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator

from hil.config.field_types import Baud, SteeringZero, Within
from hil.config.servo_models import (
    DEFAULT_MODEL,
    ServoModel,
    model_text,
    models_text,
    servo_model,
    servo_models,
)
from hil.config.servo_models.x_series_codes import BAUD_CODES

_BATTERY_V = 11.1
_MODES = 16


def _known_baud(value: int) -> int:
    if value not in BAUD_CODES:
        raise ValueError("expected one of " + ", ".join(map(str, BAUD_CODES)))
    return value


def _known_model(value: int) -> int:
    if value not in servo_models():
        raise ValueError(f"there is no control table for model {model_text(value)}; expected {models_text()}")
    return value


def _eight_ids(value: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(value)) != 8 or len(value) != 8:
        raise ValueError("expected eight different IDs")
    return value


def _in_eeprom(value: Mapping[str, int]) -> Mapping[str, int]:
    known = {r.name: r for model in servo_models().values() for r in model.table.values() if r.eeprom}
    for name, raw in value.items():
        if name not in known:
            raise ValueError(f"{name} is no EEPROM register of the servos")
        bits = 8 * known[name].size
        if not -(1 << (bits - 1)) <= raw < 1 << bits:
            raise ValueError(f"{name} = {raw} does not fit into its {bits} bits")
    return value


Id = Annotated[int, Within(0, 252, "IDs of a DYNAMIXEL bus")]
Byte = Annotated[int, Within(0, 255, "a register of one byte")]
Word = Annotated[int, Within(0, 65_535, "a register of two bytes")]


def _as_number(key: object) -> object:
    """Convert a key from TOML, where keys are text, to a number."""
    return int(key) if isinstance(key, str) and key.isdecimal() else key


Joint = Annotated[int, Within(0, 7, "eight servos"), BeforeValidator(_as_number)]
Counts = Annotated[int, Within(-(1 << 31), (1 << 31) - 1, "a register of four bytes")]
Ripple = tuple[Annotated[float, Within(0.0, 100.0, "counts of 4096 a turn")], ...]
Phase = tuple[Annotated[float, Within(-6.3, 6.3, "a turn either way")], ...]
ByDrive = tuple[Ripple, Ripple, Ripple, Ripple]
Phases = tuple[Phase, Phase, Phase, Phase]


@dataclass(frozen=True)
class ServoBusOptions:
    """Eight servos as the robot's own software left them; the bench must cope with anything else.

    Attributes:
        ids: IDs by joint: drives FL, BL, BR, FR, then steers.
        baud: baud rate of the whole bus.
        steer_mode: operating mode of the steering servos (3 position, 4 extended position).
        return_delay: Return Delay Time, 2 us steps.
        firmware: firmware of all servos.
        model_number: model number of all servos.
        firmware_by_joint, model_by_joint: firmware and model number of those that differ. A number that has
            no control table is reported all the same, with the registers of `model_number` behind it.
        eeprom: further EEPROM registers by joint and name, raw counts.
        absent: IDs that are not connected.
        after_absent: behaviour of later servos of a sync read when an earlier one does not answer, which the
            vendor does not say: `silent` for ever, or `skip` it after its time has passed.
        processing_s: time from the end of a request to the start of the reply with no return delay.
        ping_slot_s: spacing by ID of the replies to a broadcast ping.
        boot_s: silence after power-up and reboot.
        supply_v: pack voltage; where it is left out, that of the robot of the recordings (11.1 V), or what
            the model needs.
        supply_ohm: its drop by current.
        ambient_c: air temperature.
        cadence_s: period at which the servos update their measurements, as in the recordings (0.016); 0: at
            every read.
        cadence_jitter_s, cadence_gaps_per_s, cadence_longest_gap_s: deviations from that period.
        drive_start_counts: encoder counts of the drives at joint angle 0.
        horn_rad: servo angle of the steering servos at which their horns point straight on, wheel order.
        dither_counts: noise of the encoders before rounding, counts, one sigma.
        ripple_counts: error of the drives' angles that repeats with every turn, counts: by drive, amplitudes
            of one, two, ... periods a turn; none by default. The first was 1 to 6 in the recordings.
        ripple_phase_rad: phases of the same; 0 where a value is left out. At joint angle a the k-th of the
            errors is its amplitude times sin(k a + phase).
        wander_counts: smooth random error of the drives' angles, which changes while they turn, one sigma.
        steer_dither_counts: the same of the steering angles, which changes while the module's wheel turns.
        wander_s, steer_dither_s: time constants of both; 0 for values that do not depend on those before.
        velocity_from: angle of which the firmware computes the velocity: the `counts` that it shows, or its
            `angle` before noise and rounding. Of the latter neighbouring values are alike: in the recordings,
            every 16 ms, correlated by 0.89.
        overload_a: current that counts as overload; by default that of the model.
        overload_s: time at that current until the overload error.
    """

    ids: Annotated[tuple[Id, ...], AfterValidator(_eight_ids)] = (1, 2, 3, 4, 5, 6, 7, 8)
    baud: Annotated[Baud, AfterValidator(_known_baud)] = 1_000_000
    steer_mode: Annotated[int, Within(0, _MODES, "codes of the Operating Mode register")] = 3
    return_delay: Annotated[int, Within(0, 254, "steps of 2 us")] = 0
    firmware: Byte = 46
    model_number: Annotated[Word, AfterValidator(_known_model)] = DEFAULT_MODEL
    firmware_by_joint: Mapping[Joint, Byte] = field(default_factory=dict)
    model_by_joint: Mapping[Joint, Word] = field(default_factory=dict)
    eeprom: Mapping[Joint, Annotated[Mapping[str, Counts], AfterValidator(_in_eeprom)]] = field(
        default_factory=dict
    )
    absent: frozenset[Id] = frozenset()
    after_absent: Literal["silent", "skip"] = "silent"
    processing_s: float = 25e-6
    ping_slot_s: float = 1e-3
    boot_s: float = 0.15
    supply_v: float | None = None
    supply_ohm: float = 0.08
    ambient_c: float = 27.0
    cadence_s: float = 0.0
    cadence_jitter_s: float = 0.00005
    cadence_gaps_per_s: float = 0.13
    cadence_longest_gap_s: float = 0.029
    drive_start_counts: tuple[Counts, Counts, Counts, Counts] = (317, 1204, 2911, 3870)
    horn_rad: tuple[SteeringZero, SteeringZero, SteeringZero, SteeringZero] = (0.0, 0.0, 0.0, 0.0)
    dither_counts: Annotated[float, Within(0.0, 100.0, "counts of 4096 a turn")] = 0.25
    ripple_counts: ByDrive = ((), (), (), ())
    ripple_phase_rad: Phases = ((), (), (), ())
    wander_counts: Annotated[float, Within(0.0, 100.0, "counts of 4096 a turn")] = 0.0
    wander_s: Annotated[float, Within(0.0, 100.0, "a time constant")] = 0.2
    steer_dither_counts: Annotated[float, Within(0.0, 100.0, "counts of 4096 a turn")] = 0.0
    steer_dither_s: Annotated[float, Within(0.0, 100.0, "a time constant")] = 0.5
    velocity_from: Literal["counts", "angle"] = "counts"
    overload_a: float | None = None
    overload_s: float = 2.0

    def pack_v(self) -> float:
        """Return `supply_v`, or a voltage that suits the model if it is not given."""
        if self.supply_v is not None:
            return self.supply_v
        model = servo_model(self.model_number)
        low_v, high_v = model.pack_v
        return _BATTERY_V if low_v <= _BATTERY_V <= high_v else model.recommended_v

    def model_of(self, joint: int) -> int:
        """Model number that a joint's servo reports."""
        return self.model_by_joint.get(joint, self.model_number)

    def models(self) -> tuple[ServoModel, ...]:
        """Model of each of the eight servos, by joint."""
        known = servo_models()
        return tuple(known.get(self.model_of(j)) or servo_model(self.model_number) for j in range(8))
