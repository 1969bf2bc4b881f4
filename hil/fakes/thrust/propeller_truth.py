"""True parameters of the emulated propellers; assumptions where no source is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hil.config.values import Within
from hil.fakes.initial_support import InitialSupport


@dataclass(frozen=True)
class ThrustTruthOptions:
    """Initial state of the propellers, and their time constant.

    Attributes:
        start: as for the emulated fan: `tethered`, `running`, `off`, or `by use`.
        lag_s: time constant of the force.
    """

    start: InitialSupport = "by use"
    lag_s: Annotated[float, Within(0.001, 10.0, "s")] = 0.1
