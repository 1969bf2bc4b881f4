"""True parameters of the emulated propellers; assumptions where no source is known."""

from dataclasses import dataclass
from typing import Annotated

from hil.config.field_types import Within
from hil.config.thrust import TeensyConfig, Thrust
from hil.fakes.motor_controllers.initial_support import InitialSupport


@dataclass(frozen=True)
class ThrustTruthOptions:
    """Initial state of the propellers, and their time constant.

    Attributes:
        start: initial state, as for the emulated fan: `tethered`, `running`, `off`, or `by use`.
        lag_s: time constant of the force.
        full_force_n: true force of all propellers at full throttle; that of `[thrust]` when left out.
    """

    start: InitialSupport = "by use"
    lag_s: Annotated[float, Within(0.001, 10.0, "s")] = 0.1
    full_force_n: Thrust | None = None

    def true_ratings(self, config: TeensyConfig) -> TeensyConfig:
        """The propellers with their true full force in place of that of the bench file."""
        true = self.full_force_n
        return config if true is None else config.model_copy(update={"full_force_n": true})
