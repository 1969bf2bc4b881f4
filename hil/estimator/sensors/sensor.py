"""Interface of a sensor of the filter: its intake, its constants, and the kernels of the event loop.

Notation of the kernels, the same for every sensor: `x` (20,) is the state and `p` (20, 20) its covariance, in
the order of `hil.estimator.state_vector`; `m`, `row` and `par` are the sensor's own memory, event row and
parameters; `t_ns` is the sample's stamp, ns since the start. A sample is compared in `count` <= 8 rows: `z`
(8,) the measured values, `var` (8,) their variances (negative: row not usable), `aux` (5,) figures that the
prediction needs. `out` (8,) is the prediction from the state, `h` (8, 20) its derivative by the state, `nu`
(8,) measured minus predicted, `nis` (8,) its square over its variance. `late` (20,) and `spread` (20, 20) are
the quantities that the smoother carries backwards. Units are those of the state and of the rows.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Record
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import inner

FARTHEST_M, FARTHEST_RAD = 1e3, 1e6
"""Larger finite values are implausible; they would leave no digits for the covariance."""
SAME_NS = 1000.0
"""Samples of one sensor whose stamps are closer together than this are duplicates."""

REFUSED, USED, NEW_FRAME, DUPLICATE = range(4)
"""Results of `Sensor.admit`: refused, usable, starts a new frame, duplicate."""


class Tally(Record):
    """Statistics of the rows of one kind; rewound with the state.

    Attributes:
        accepted, rejected: number of rows since the start.
        nis: normalised innovation squared of the last sample: innovation' S^-1 innovation with the covariance
            S that the filter expected of it. For a consistent filter its mean is the number of rows.
        nis_mean: running mean of `nis` per row; 1 is ideal.
        in_row: number of consecutive rejected samples.
        reanchored: number of times that the sensor was let in again after too many consecutive rejections.
    """

    accepted: float
    rejected: float
    nis: float
    nis_mean: float
    in_row: float
    reanchored: float


@inner
def tally(own: Tally, nis: float, used: int, rows: int, samples: float) -> None:
    """Count a sample's accepted and rejected rows, and update the running mean of the NIS over `samples`."""
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
    """`Sensor.account` for rows that are accepted or rejected together."""
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
    """Whether a stamp repeats that of the last sample; `last_ns` is negative before the first."""
    return last_ns >= 0.0 and t_ns - last_ns < SAME_NS


@inner
def no_frame(t_ns: float, x: Array, p: Array, m: Record, row: Record, par: Record) -> None:
    """`Sensor.new_frame` of a sensor without a frame of its own: does nothing."""


@inner
def undo_nothing(
    t_ns: float, x: Array, m: Record, row: Record, par: Record, late: Array, spread: Array
) -> None:
    """`Sensor.undo` of a sensor that changes the state through its rows only: does nothing."""


class Sensor(Protocol):
    """Interface that each module in this folder implements; functions that take `m` are kernels."""

    @property
    def NAME(self) -> str:
        """Field name in `Measurements` and in the records of `hil.estimator.kernel_layout`."""

    @property
    def NONLINEAR(self) -> bool:
        """Whether the model is so nonlinear that the unscented filter draws sigma points for it."""

    @property
    def GATED_TOGETHER(self) -> bool:
        """Whether all rows pass one gate of three degrees of freedom, instead of one gate per row."""

    @property
    def ANGLE_ROW(self) -> int:
        """Index of the row that is an angle, whose innovation is wrapped; -1: none."""

    @property
    def START(self) -> Mapping[str, float]:
        """Start values of the memory fields that do not start at zero, by path."""

    @property
    def FIGURES(self) -> Mapping[str, str]:
        """Memory path of each diagnostic, by the diagnostic's name."""

    @property
    def Parameters(self) -> type[Record]:
        """Record of the parameters of the kernels."""

    @property
    def Memory(self) -> type[Record]:
        """Record of the sensor's memory; rewound with the state, including counters and last samples."""

    @property
    def Row(self) -> type[Record]:
        """Record of one sample."""

    def is_used(self, config: EstimatorConfig) -> bool:
        """Whether the configuration uses this sensor's samples."""

    def values(self, config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> Mapping[str, Any]:
        """Values of `Parameters` from the configuration."""

    def pack(self, sample: Any) -> Sequence[float] | str:
        """Values (n,) of `Row` for a sample, or the reason of refusal."""

    def admit(self, t_ns: float, m: Any, row: Any, par: Any) -> int:
        """Decide on a sample: `REFUSED` (and counted), `USED`, `NEW_FRAME` or `DUPLICATE`."""

    def observe(self, t_ns: float, m: Any, row: Any, par: Any, z: Array, var: Array, aux: Array) -> int:
        """Fill `z`, `var` and `aux`; return the number of rows, 0 when there is nothing to compare."""

    def predicted(self, x: Array, aux: Array, par: Any, out: Array) -> None:
        """Fill `out` (8,) with the rows predicted from the state."""

    def jacobian(self, x: Array, aux: Array, par: Any, h: Array) -> None:
        """Fill `h` (8, 20) with the derivative of `predicted` by the state; `h` is zero before."""

    def account(
        self, m: Any, nu: Array, nis: Array, var: Array, count: int, gate: float, samples: float
    ) -> int:
        """Count the rows whose `nis` (8,) lies within the gate, and the others; return the number within.

        `nu` (8,) is measured minus predicted; a diagnostic is taken from it.
        """

    def reanchor(self, limit: float, t_ns: float, p: Array, m: Any, par: Any) -> bool:
        """Raise the state's variance after `limit` consecutive rejected samples; no sensor stays locked out.

        Returns:
            True if the sensor's own frame must start again at this sample.
        """

    def new_frame(self, t_ns: float, x: Array, p: Array, m: Any, row: Any, par: Any) -> None:
        """Start the sensor's own frame at this sample."""

    def remember(self, t_ns: float, x: Array, p: Array, m: Any, row: Any, par: Any) -> None:
        """Store what the next sample will be compared with."""

    def undo(self, t_ns: float, x: Array, m: Any, row: Any, par: Any, late: Array, spread: Array) -> None:
        """Carry what later samples say back through the state changes of the three kernels above.

        `x` and `m` are those after the sample; `late` (20,) and `spread` (20, 20) as in
        `hil.estimator.smoother.pull_update`.
        """
