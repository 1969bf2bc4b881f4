"""Checks that an estimate is usable: finite, with a covariance, of this cycle.

Comparisons of an estimate with other data use its variances and its time: with a variance of NaN, or a time
that stands still, they would never find a difference.
"""

import math
from collections.abc import Callable

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import SafetyStop
from hil.core.signals import Event, RobotState
from hil.loop.cycle_data import Check, Cycle

_OLD_NS = nanoseconds(0.1)
"""Largest age of an estimate, as that of the servos' angles that it uses."""
_ROUNDING = -1e-9
"""Rounding error (m^2 etc.): a variance of zero may be computed slightly negative."""
_OF = ("x", "y", "heading", "speed along x", "speed along y", "turn rate")
_REMEDY = "fix the estimator, or follow another (feedback: odometry, ekf or ukf)"


class UsableCheck(Check):
    """Checks that the estimate in the loop is usable."""

    def on_estimate(self, cycle: Cycle) -> None:
        """Check that the estimate is finite, with valid variances, and of this cycle.

        Raises:
            SafetyStop: `not_finite`, `negative_variance` or `stale_estimate`.
        """
        assert cycle.state is not None
        if found := unusable(cycle.state, cycle.inputs.t_ns):
            reason, message, remedy = found
            raise SafetyStop(reason, f"{message}; {remedy}" if remedy else message)


class ObserverCheck(Check):
    """Checks the estimates outside the loop: reports each kind of fault once per estimator and run.

    Attributes:
        checked: names of the observers that are checked.
    """

    checked: tuple[str, ...] = ()

    def on_estimate(self, cycle: Cycle) -> None:
        """Check every estimate that control does not use."""
        for name in self.checked:
            cycle.events += self.judge(name, cycle.observers[name], cycle.inputs.t_ns)

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the reported faults."""
        self._known: set[tuple[str, str]] = set()

    def judge(self, name: str, state: RobotState, now_ns: int) -> tuple[Event, ...]:
        """Warn if the estimate of the observer `name` has a fault that was not reported before."""
        found = unusable(state, now_ns)
        if found is None or (name, found[0]) in self._known:
            return ()
        self._known.add((name, found[0]))
        return (Event(now_ns, "warning", name, f"observer {name}: {found[1]}; warned of once"),)


def unusable(state: RobotState, now_ns: int) -> tuple[str, str, str] | None:
    """Reason, message and remedy; None for an estimate that can be used."""
    values = state.pose_body_in_wall.tolist() + state.twist_body.tolist()
    if not math.isfinite(sum(values)):
        return "not_finite", "the estimated state is not finite", ""
    variances: list[float] = state.covariance.diagonal().tolist()
    if not math.isfinite(sum(variances)):
        message = (
            f"the estimate has no usable covariance: its variance of {_named(variances, math.isfinite)} "
            "is not finite"
        )
        return "not_finite", message, _REMEDY
    if min(variances) < _ROUNDING:
        whose = _named(variances, _ROUNDING.__le__)
        message = f"the estimate's variance of {whose} is negative, expected 0 or more"
        return "negative_variance", message, _REMEDY
    if abs(now_ns - state.t_ns) > _OLD_NS:
        off_s = (state.t_ns - now_ns) / NS_PER_S
        when = f"{abs(off_s):.3f} s {'ahead of' if off_s > 0.0 else 'behind'}"
        message = (
            f"the estimate's time is {when} that of the cycle, expected at most {_OLD_NS / NS_PER_S:g} s"
        )
        return "stale_estimate", message, _REMEDY
    return None


def _named(variances: list[float], good: Callable[[float], bool]) -> str:
    return ", ".join(name for name, value in zip(_OF, variances, strict=True) if not good(value))
