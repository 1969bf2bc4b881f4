"""Whether an estimate can be used at all: it is a number, says how sure it is, and is of this cycle.

What compares an estimate with others weighs it by its variances and by its time: with a variance that is not
a number, or a time that stands still, nothing would ever be found to differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.errors import SafetyStop
from hil.vocabulary.signals import RobotState

_OLD_NS = nanoseconds(0.1)
"""As old as the servos' angles may be that it is made of."""
_ROUNDING = -1e-9
"""m^2 and the like: a variance of zero may come out so far below it."""
_OF = ("x", "y", "heading", "speed along x", "speed along y", "turn rate")
_REMEDY = "mend the estimator, or follow another (feedback: odometry, ekf or ukf)"


def must_be_usable(state: RobotState, now_ns: int | None) -> None:
    """Refuse an estimate that nobody can judge.

    Args:
        state: the estimate.
        now_ns: time of the cycle; None where none was judged before.

    Raises:
        SafetyStop: `not_finite`, `negative_variance` or `stale_estimate`.
    """
    values = state.pose_body_in_wall.tolist() + state.twist_body.tolist()
    if not all(map(math.isfinite, values)):
        raise SafetyStop("not_finite", "the estimated state is not finite")
    variances: list[float] = state.covariance.diagonal().tolist()
    if not all(map(math.isfinite, variances)):
        raise SafetyStop(
            "not_finite",
            f"the estimate does not say how sure it is: its variance of {_named(variances, math.isfinite)} "
            f"is not finite; {_REMEDY}",
        )
    if min(variances) < _ROUNDING:
        raise SafetyStop(
            "negative_variance",
            f"the estimate's variance of {_named(variances, _ROUNDING.__le__)} is negative, expected 0 or "
            f"more; {_REMEDY}",
        )
    if now_ns is not None and abs(now_ns - state.t_ns) > _OLD_NS:
        off_s = (state.t_ns - now_ns) / NS_PER_S
        when = f"{abs(off_s):.3f} s {'ahead of' if off_s > 0.0 else 'behind'}"
        raise SafetyStop(
            "stale_estimate",
            f"the estimate's time is {when} that of the cycle, expected at most {_OLD_NS / NS_PER_S:g} s; "
            f"{_REMEDY}",
        )


def _named(variances: list[float], good: Callable[[float], bool]) -> str:
    return ", ".join(name for name, value in zip(_OF, variances, strict=True) if not good(value))
