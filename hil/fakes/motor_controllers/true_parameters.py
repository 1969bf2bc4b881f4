"""True parameters of the emulated fan: settings of its controller, its battery, its initial state."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeVar

from hil.config.adhesion import Force, MotorConfig
from hil.config.field_types import Within
from hil.fakes.motor_controllers.initial_support import InitialSupport

StatusMessage = Annotated[int, Within(1, 6, "a VESC has status messages 1 to 6")]
Rate = Annotated[float, Within(0.0, 1000.0, "messages per second")]
Poles = Annotated[int, Within(-50, 50, "pole pairs, not 0; below 0 the controller counts backwards")]
Speed = Annotated[float, Within(1000.0, 200_000.0, "1/min")]
Amps = Annotated[float, Within(0.5, 300.0, "A")]
C = TypeVar("C", bound=MotorConfig)


@dataclass(frozen=True)
class MotorTruthOptions:
    """Settings of the controller as VESC Tool has them, and physics; assumptions where no source is known.

    Attributes:
        start: `tethered`: the robot hangs on a tether until the fan has carried it once. `running`: the fan
            runs at the working point, as if a daemon had kept it running. `off`. `by use`: running in
            virtual time, tethered at the wire, where it is not known when a client comes.
        timeout_s: time without a `SET_*` after which the motor is released; 0 for never.
        rate_1_hz, rate_2_hz: two rates of status messages.
        messages_1, messages_2: numbers of the status messages (1 to 6) at each rate; as delivered none: `[]`.
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
    RATINGS: ClassVar[Mapping[str, str]] = {}
    """Field of the true value of a rating, by the rating's key in the bench file."""

    def __post_init__(self) -> None:
        if getattr(self, "pole_pairs", None) == 0:
            raise ValueError("pole_pairs = 0: a motor has at least one")

    def true_ratings(self, config: C) -> C:
        """The motor with its true ratings in place of those of the bench file."""
        true: dict[str, Any] = {key: getattr(self, field) for key, field in self.RATINGS.items()}
        return config.model_copy(update={key: value for key, value in true.items() if value is not None})


@dataclass(frozen=True)
class FanTruthOptions(MotorTruthOptions):
    """True ratings of the fan where they differ from `[adhesion]`; as there when left out.

    Attributes:
        rated_force_n, rated_rpm: true force at a speed.
        rated_input_a: true battery current at that speed.
        rpm_per_v: true speed of the motor per volt, unloaded.
    """

    rated_force_n: Force | None = None
    rated_rpm: Speed | None = None
    rated_input_a: Amps | None = None
    rpm_per_v: Annotated[float, Within(10.0, 20_000.0, "1/min per V")] | None = None
    RATINGS: ClassVar[Mapping[str, str]] = {
        key: key for key in ("rated_force_n", "rated_rpm", "rated_input_a", "rpm_per_v")
    }


@dataclass(frozen=True)
class AdhesionTruthOptions(FanTruthOptions):
    """Imperfections of a fan on a VESC.

    Attributes:
        pole_pairs: true number of the motor; below 0 for a controller that counts backwards.
    """

    pole_pairs: Poles | None = None
    RATINGS: ClassVar[Mapping[str, str]] = {**FanTruthOptions.RATINGS, "pole_pairs": "pole_pairs"}
