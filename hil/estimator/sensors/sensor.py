"""What a sensor is to the filter: its intake, its numbers, and the kernels that the event loop calls.

Notation of the kernels, the same for every sensor: `x` (20,) is the state and `p` (20, 20) its covariance, in
the order of `hil.estimator.state_vector`; `m`, `row` and `par` are the sensor's own memory, event row and
parameters; `t_ns` is the sample's stamp, ns since the start. A sample is compared in `count` <= 8 rows: `z`
(8,) what was measured, `var` (8,) its variances (negative: row not usable), `aux` (5,) figures that the
prediction needs. `out` (8,) is what the state predicts, `h` (8, 20) its derivative by the state, `nu` (8,)
measured minus predicted, `nis` (8,) its square over its variance. `late` (20,) and `spread` (20, 20) are what
the smoother carries back. Units are those of the state and of the rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Record
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import inner

FARTHEST_M, FARTHEST_RAD = 1e3, 1e6
"""What is finite but beyond any robot would leave no digits for the covariance."""
SAME_NS = 1000.0
"""Two samples of one sensor that lie no further apart are one and the same."""

REFUSED, USED, NEW_FRAME, DUPLICATE = range(4)
"""What `Sensor.admit` says of a sample: refused, usable, good for the start of a new frame, known already."""


class Tally(Record):
    """How the rows of one kind have fared; rewound with the state.

    Attributes:
        accepted, rejected: how many rows, ever.
        nis: normalised innovation squared of the last sample: innovation' S^-1 innovation with the covariance
            S that the filter expected of it. For a consistent filter its mean is the number of rows.
        nis_mean: running mean of `nis` per row; 1 is ideal.
        in_row: samples rejected in a row.
        reanchored: how often the sensor was let in again after too many of these.
    """

    accepted: float
    rejected: float
    nis: float
    nis_mean: float
    in_row: float
    reanchored: float


@inner
def tally(own: Tally, nis: float, used: int, rows: int, samples: float) -> None:
    """Count accepted and rejected rows of a sample; its innovation enters a mean over `samples`."""
    own.accepted += used
    own.rejected += rows - used
    if rows == 0:
        return
    own.nis = nis
    own.nis_mean += (nis / rows - own.nis_mean) / samples
    if used > 0:
        own.in_row = 0.0
    else:
        own.in_row += 1.0


@inner
def account_together(own: Tally, nis: Array, var: Array, count: int, gate: float, samples: float) -> int:
    """`Sensor.account` of rows that pass together or not at all."""
    total, usable, used = 0.0, 0, 0
    for i in range(count):
        if var[i] >= 0.0:
            usable += 1
            used += 1 if nis[i] <= gate else 0
            total += nis[i]
    tally(own, total, used, usable, samples)
    return used


@inner
def is_repeated(t_ns: float, last_ns: float) -> bool:
    """Whether a stamp is that of the last sample (negative: there was none)."""
    return last_ns >= 0.0 and t_ns - last_ns < SAME_NS


@inner
def no_frame(t_ns: float, x: Array, p: Array, m: Record, row: Record, par: Record) -> None:
    """`Sensor.new_frame` of a sensor that has no frame of its own."""


@inner
def undo_nothing(
    t_ns: float, x: Array, m: Record, row: Record, par: Record, late: Array, spread: Array
) -> None:
    """`Sensor.undo` of a sensor that changes the state by its rows alone."""


class Sensor(Protocol):
    """What a module in this folder defines to be a sensor of the filter; functions over `m` are kernels."""

    @property
    def NAME(self) -> str:
        """Its field of `Measurements`, and of the records of `hil.estimator.kernel_layout`."""

    @property
    def BENT(self) -> bool:
        """Whether its model is so nonlinear that the unscented filter draws sigma points for it."""

    @property
    def GATED_TOGETHER(self) -> bool:
        """Whether its rows pass one gate of three degrees of freedom, instead of each its own."""

    @property
    def ANGLE_ROW(self) -> int:
        """Which row is an angle, whose difference goes by the shorter way round; -1: none."""

    @property
    def START(self) -> Mapping[str, float]:
        """Places in the memory that do not begin at zero, with their values."""

    @property
    def FIGURES(self) -> Mapping[str, str]:
        """Names of diagnostics, and their places in the memory."""

    @property
    def Parameters(self) -> type[Record]:
        """What its kernels go by."""

    @property
    def Memory(self) -> type[Record]:
        """What it remembers; goes with the state, so that a rewind also rewinds counters and last samples."""

    @property
    def Row(self) -> type[Record]:
        """One sample."""

    def is_used(self, config: EstimatorConfig) -> bool:
        """Whether a configuration lets its samples in at all."""

    def values(self, config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> Mapping[str, Any]:
        """Values of `Parameters`."""

    def pack(self, sample: Any) -> Sequence[float] | str:
        """The floats (n,) of `Row` of a sample, or why it is refused."""

    def admit(self, t_ns: float, m: Any, row: Any, par: Any) -> int:
        """One of `REFUSED` (and counted), `USED`, `NEW_FRAME`, `DUPLICATE`."""

    def observe(self, t_ns: float, m: Any, row: Any, par: Any, z: Array, var: Array, aux: Array) -> int:
        """Fill `z`, `var` and `aux`; the count of rows, 0 when there is nothing to compare."""

    def predicted(self, x: Array, aux: Array, par: Any, out: Array) -> None:
        """Fill the rows (8,) that a state predicts."""

    def jacobian(self, x: Array, aux: Array, par: Any, h: Array) -> None:
        """Fill their derivative (8, 20) by the state; zeroed before."""

    def account(
        self, m: Any, nu: Array, nis: Array, var: Array, count: int, gate: float, samples: float
    ) -> int:
        """Count the rows whose `nis` (8,) lies within the gate, and the others; how many lie within.

        `nu` (8,) is what was measured minus what was predicted, of which a figure is kept.
        """

    def let_in(self, limit: float, t_ns: float, p: Array, m: Any, par: Any) -> bool:
        """Trust the state less once `limit` samples in a row were rejected: none is locked out for ever.

        Returns:
            Whether the sensor's own frame is to begin anew at this sample.
        """

    def new_frame(self, t_ns: float, x: Array, p: Array, m: Any, row: Any, par: Any) -> None:
        """Let the sensor's own frame begin at this sample."""

    def remember(self, t_ns: float, x: Array, p: Array, m: Any, row: Any, par: Any) -> None:
        """Keep what the next sample is compared with."""

    def undo(self, t_ns: float, x: Array, m: Any, row: Any, par: Any, late: Array, spread: Array) -> None:
        """Carry what later samples say back through what the three kernels above did to the state.

        `x` and `m` are those after the sample; `late` (20,) and `spread` (20, 20) as in
        `hil.estimator.smoother.pull_update`.
        """
