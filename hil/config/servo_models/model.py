"""A servo model: its control table with units and limits, and what its motor is made of."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hil.config.servo_models.control_table_entry import Register

_RPM = 2.0 * math.pi / 60.0
_LEAST_SHARE, _LOW_SHARE = 2.0 / 3.0, 0.9


@dataclass(frozen=True)
class Performance:
    """Stall and no-load rows of the vendor's specification at one supply voltage."""

    supply_v: float
    stall_torque_n_m: float
    stall_current_a: float
    no_load_rpm: float

    @property
    def no_load_rad_s(self) -> float:
        """Speed without load."""
        return self.no_load_rpm * _RPM


@dataclass(frozen=True)
class Motor:
    """Constants of the emulated motor, at the output of the gear.

    Attributes:
        torque_constant_n_m_a, back_emf_v_s_rad, resistance_ohm: constants of motor and gear.
        inertia_kg_m2: moment of inertia of rotor and gear.
        overload_a: current from which on the emulated servo counts overload.
    """

    torque_constant_n_m_a: float
    back_emf_v_s_rad: float
    resistance_ohm: float
    inertia_kg_m2: float
    overload_a: float


@dataclass(frozen=True, eq=False)
class ServoModel:
    """One model of servo.

    Attributes:
        number, name: model number on the bus, and the vendor's name.
        table: control table by register name.
        table_size: bytes from address 0 to its end.
        counts_per_turn, zero_counts: counts of a position; the centre is the zero of an angle.
        fast_read_firmware: the first that knows fast sync reads.
        gear_ratio: motor turns per output turn.
        a_per_count: SI value of one count of a current.
        supply_v: lowest and highest permitted input voltage.
        recommended_v: input voltage that the vendor recommends.
        performance: the specification's rows, by voltage.
        motor: motor of the emulated servo.
    """

    number: int
    name: str
    table: Mapping[str, Register]
    table_size: int
    counts_per_turn: int
    zero_counts: int
    fast_read_firmware: int
    gear_ratio: float
    a_per_count: float
    supply_v: tuple[float, float]
    recommended_v: float
    performance: tuple[Performance, ...]
    motor: Motor

    @property
    def rad_per_count(self) -> float:
        """SI value of one count of a position."""
        return self.table["present_position"].scale

    @property
    def rad_s_per_count(self) -> float:
        """SI value of one count of a velocity."""
        return self.table["present_velocity"].scale

    @property
    def full_pwm(self) -> int:
        """Counts of a PWM of 100 %."""
        return self.table["pwm_limit"].default

    @property
    def top_speed_rad_s(self) -> float:
        """Upper bound of its speed: without load at the highest voltage of the specification, rounded up."""
        return math.ceil(10.0 * max(row.no_load_rad_s for row in self.performance)) / 10.0

    @property
    def pack_v(self) -> tuple[float, float]:
        """Permitted supply, V: within its voltage limits, and at least two thirds of the recommended."""
        low, high = self.table["min_voltage_limit"], self.table["max_voltage_limit"]
        return max(low.default * low.scale, _LEAST_SHARE * self.recommended_v), high.default * high.scale

    @property
    def low_supply_v(self) -> float:
        """Supply, V, below which a person should check: the lowest permitted, or 90 % of the recommended."""
        return min(self.supply_v[0], _LOW_SHARE * self.recommended_v)
