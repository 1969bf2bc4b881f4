"""True parameters of the emulated fan: settings of its controller, its battery, its initial state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hil.config.values import Within
from hil.fakes.initial_support import InitialSupport

StatusMessage = Annotated[int, Within(1, 6, "a VESC has status messages 1 to 6")]
Rate = Annotated[float, Within(0.0, 1000.0, "messages per second")]


@dataclass(frozen=True)
class AdhesionTruthOptions:
    """Settings of the controller as VESC Tool has them, and physics; assumptions where no source is known.

    Attributes:
        start: `tethered`: the robot hangs on a tether until the fan has carried it once. `running`: the fan
            runs at the working point, as if a daemon had kept it running. `off`. `by use`: running in
            virtual time, tethered at the wire, where it is not known when a client comes.
        timeout_s: time without a `SET_*` after which the motor is released; 0 for never.
        rate_1_hz, rate_2_hz: two rates of status messages.
        messages_1, messages_2: which status messages (1 to 6) go out at each rate; as delivered none: `[]`.
        firmware: version that it reports.
        twins: further controllers of the same id on the bus.
        pack_v: voltage of the battery at no load.
        pack_ohm: its resistance.
        pack_ah: its charge: it sags from full to empty by a fifth of its voltage.
        motor_ohm: resistance of the motor.
        spin_up_s, spin_down_s: time constants of the speed.
        cut_start_v, cut_end_v: battery voltage from which the current is reduced, and where it is none.
        hot_start_c, hot_end_c: the same for the temperature of the power stage.
        ambient_c: air temperature.
        heating_c_per_a2: heating of the power stage per square of the motor's current.
        highest_a: largest current of the motor.
    """

    start: InitialSupport = "by use"
    timeout_s: float = 1.0
    rate_1_hz: Rate = 50.0
    rate_2_hz: Rate = 5.0
    messages_1: tuple[StatusMessage, ...] = (1,)
    messages_2: tuple[StatusMessage, ...] = (4, 5)
    firmware: str = "6.05"
    twins: Annotated[int, Within(0, 10, "further controllers")] = 0
    pack_v: float = 23.4
    pack_ohm: float = 0.020
    pack_ah: Annotated[float, Within(0.01, 1000.0, "Ah")] = 10.0
    motor_ohm: float = 0.030
    spin_up_s: Annotated[float, Within(0.01, 10.0, "s")] = 0.25
    spin_down_s: Annotated[float, Within(0.01, 10.0, "s")] = 0.6
    cut_start_v: float = 19.2
    cut_end_v: float = 18.0
    hot_start_c: Annotated[float, Within(20.0, 200.0, "degC")] = 85.0
    hot_end_c: Annotated[float, Within(20.0, 200.0, "degC")] = 100.0
    ambient_c: float = 25.0
    heating_c_per_a2: Annotated[float, Within(0.0, 1.0, "K per A^2")] = 0.02
    highest_a: Annotated[float, Within(1.0, 500.0, "A")] = 100.0
