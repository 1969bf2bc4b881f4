"""Computes residuals and derivatives in one pass over recordings, block by block, compiled by numba.

The arithmetic is that of `hil.calibration.motion_models` and `hil.robot.odometry`, which numpy runs on
arrays. Here it runs on numbers, without arrays between wheels and residuals.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.calibration import motion_models
from hil.calibration.evaluation import roll
from hil.calibration.motion_models import COLD, FRICTION, motion_derivative, solve_motion
from hil.core.geometry import Array, Bools
from hil.robot import contact_laws
from hil.robot.odometry import chord, chord_slopes
from hil.support.numba_jit import compile_for, inner, kernel

_PARTS = (
    *(contact_laws.slip, contact_laws.friction, contact_laws.raised, contact_laws.rolled_mean),
    *(contact_laws.stiffness, contact_laws.reweighted, contact_laws.continued, contact_laws.polished),
    *(contact_laws.stepped, contact_laws.dissipation, contact_laws.dissipation_slopes),
    *(contact_laws.with_contact, contact_laws.creep_stiffness, contact_laws.creep_balance),
    *(contact_laws.inverse3, contact_laws.times),
    *(motion_models.mean_motion, motion_models.contact_response, motion_models.put_column),
    *(motion_models.mean_response, motion_derivative, solve_motion, roll, chord, chord_slopes),
)
"""Functions that a pass calls; numpy also runs them on arrays."""
for _plain in _PARTS:
    inner(_plain)


class Contacts(NamedTuple):
    """Law of contact: its kind, loads, exponent of dry friction, creep ratio.

    Attributes:
        load: (4,) relative normal loads.
    """

    kind: int
    load: Array
    power: float
    ratio: float


class PassInputs(NamedTuple):
    """Recorded data.

    Attributes:
        wheel_rad: (R, N, 8) raw wheel vectors.
        first: (R, 3) poses at the start.
        truth: (R, N, 3) poses at the blocks' ends.
        known: (R, N) whether `truth` is known; elsewhere errors and derivatives are 0.
        counts: (R,) numbers of real blocks; the results of the others are not written.
        scale: (R, 3) factors of the errors.
    """

    wheel_rad: Array
    first: Array
    truth: Array
    known: Bools
    counts: npt.NDArray[Any]
    scale: Array


class PassResults(NamedTuple):
    """Arrays that a pass fills.

    Attributes:
        last: (3, R N) body motions; also read as start values.
        errors: (R, N, 3) scaled pose errors.
        slopes: (R, N, 3, m) derivatives of `errors`; not computed where empty.
    """

    last: Array
    errors: Array
    slopes: Array


@kernel
def run_pass(
    law: Contacts, z: Array, turned: Array, start: int, driven: PassInputs, reckoned: PassResults
) -> None:
    """Fill scaled pose errors and their derivatives.

    Args:
        law: law of contact.
        z: (m,) parameters.
        turned: (2, 4) from `turned_wheels`.
        start: use of the last body motions: COLD, WARM or KNOWN.
        driven: recorded data.
        reckoned: results.
    """
    kind, load, power, ratio = law
    wheel_rad, first, truth, known, counts, scale = driven
    last, errors, slopes = reckoned
    size, wanted = len(z), len(slopes) > 0
    u, moved, sums = np.empty(8), np.empty((3, size)), np.empty((3, size))
    for r in range(len(counts)):
        x, y, theta = first[r, 0], first[r, 1], first[r, 2]
        sums[:] = 0.0
        for k in range(counts[r]):
            at = r * wheel_rad.shape[1] + k
            roll(turned, wheel_rad[r, k], u)
            b = solve_motion(kind, load, power, ratio, z, u, (last[0, at], last[1, at], last[2, at]), start)
            last[0, at], last[1, at], last[2, at] = b
            c, s = chord(theta, b[2])
            way_x, way_y = c * b[0] - s * b[1], s * b[0] + c * b[1]
            if wanted:
                motion_derivative(kind, load, power, ratio, z, u, b, moved)
                by_x, by_y = chord_slopes(theta, b)
                for i in range(size):
                    mx, my, mt = moved[0, i], moved[1, i], moved[2, i]
                    turn = sums[2, i] + mt
                    sums[0, i] += c * mx - s * my - way_y * turn + by_x * mt
                    sums[1, i] += s * mx + c * my + way_x * turn + by_y * mt
                    sums[2, i] = turn
                for axis in range(3):
                    factor = scale[r, axis] if known[r, k] else 0.0
                    for i in range(size):
                        slopes[r, k, axis, i] = factor * sums[axis, i]
            x, y, theta = x + way_x, y + way_y, theta + b[2]
            seen = 1.0 if known[r, k] else 0.0
            errors[r, k, 0] = seen * scale[r, 0] * (x - truth[r, k, 0])
            errors[r, k, 1] = seen * scale[r, 1] * (y - truth[r, k, 1])
            errors[r, k, 2] = seen * scale[r, 2] * (theta - truth[r, k, 2])


@cache
def load_pass() -> None:
    """Load the compiled code of `run_pass`, or compile it where none is cached."""
    law, one = Contacts(FRICTION, np.ones(4), 1.0, 1.0), np.zeros((1, 1, 3))
    known, counts = np.zeros((1, 1), dtype=np.bool_), np.zeros(1, dtype=np.int64)
    driven = PassInputs(np.zeros((1, 1, 8)), np.zeros((1, 3)), one, known, counts, np.ones((1, 3)))
    reckoned = PassResults(np.zeros((3, 1)), one, np.zeros((1, 1, 3, 16)))
    compile_for(run_pass, law, np.ones(16), np.ones((2, 4)), COLD, driven, reckoned)
