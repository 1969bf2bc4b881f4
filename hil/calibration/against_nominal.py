"""Compares a calibration with doing nothing: nominal odometry, on recordings that the fit has not seen."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hil.calibration.cross_validation import Table

_KINDS = {
    "leave_one_repetition_out": "repetitions that the fit has not seen",
    "leave_one_motion_out": "motions that the fit has not seen",
    "in_sample": "its own recordings, none was left out",
}
"""Tables to judge by, the first that there is, with the recordings that each is of."""
_AS_GOOD, _LEAST_M = 1.05, 1e-4
_POSITION, _HEADING = "rmse_position_m", "rmse_theta_rad"

Row = Mapping[str, float]


@dataclass(frozen=True)
class AgainstNominal:
    """Mean errors over motions, of nominal odometry and of a result.

    Attributes:
        on: name of the table with the result's errors.
        nominal: errors of nominal odometry on the same motions.
        result: errors of the result.
        on_motions: errors of fits without the motion itself, where these are worse than `result`.
        lever_m: distance of the wheels from the middle; a heading error counts at the wheels.
        motions: motions that the errors are of.
        lacking: kinds of motion of which every recording was left out: no error is of these.
    """

    on: str
    nominal: Row
    result: Row
    on_motions: Row | None
    lever_m: float
    motions: tuple[str, ...] = ()
    lacking: tuple[str, ...] = ()

    def _at_wheels_m(self, row: Row) -> float:
        return float(np.hypot(row[_POSITION], self.lever_m * row[_HEADING]))

    @property
    def _least_m(self) -> float:
        return max(_LEAST_M, (_AS_GOOD - 1.0) * self._at_wheels_m(self.nominal))

    @property
    def by_m(self) -> float:
        """Error of nominal odometry minus that of the result, at the wheels, m."""
        return self._at_wheels_m(self.nominal) - self._at_wheels_m(self.result)

    @property
    def worse(self) -> bool:
        """Whether the result, or its position alone, is worse than nominal odometry by 5 % and 0.1 mm."""
        further_m = self.result[_POSITION] - self.nominal[_POSITION]
        least_m = max(_LEAST_M, (_AS_GOOD - 1.0) * self.nominal[_POSITION])
        return self.by_m < -self._least_m or further_m > least_m

    def in_words(self) -> str:
        """The comparison in one line."""
        alike = abs(self.by_m) <= self._least_m and not self.worse
        word = "WORSE than" if self.worse else "as good as" if alike else "better than"
        by = "" if alike else f" by {1e3 * abs(self.by_m):.1f} mm at the wheels"
        by = " in its position" if self.worse and self.by_m > 0.0 else by
        line = (
            f"on {_KINDS[self.on]}: {word} nominal odometry{by} "
            f"({_errors(self.result)} against {_errors(self.nominal)})"
        )
        if self.lacking:
            line += f"; not of {', '.join(self.lacking)}, whose recordings are left out"
        if self.on_motions is None:
            return line
        return f"{line}; on {_KINDS['leave_one_motion_out']}: {_errors(self.on_motions)}"

    def to_json(self) -> dict[str, object]:
        """Errors in m and rad; `on_unseen_motions` is None where they are not worse."""
        return {
            "on": self.on,
            "motions": list(self.motions),
            "lacking": list(self.lacking),
            "nominal": dict(self.nominal),
            "result": dict(self.result),
            "on_unseen_motions": None if self.on_motions is None else dict(self.on_motions),
            "better_by_m": self.by_m,
            "worse": self.worse,
        }


def against_nominal(tables: Mapping[str, Table], nominal: Table, lever_m: float) -> AgainstNominal:
    """Compare by the first table of those that exist: repetitions left out, motions left out, in sample.

    Args:
        tables: errors of the result by motion, by name of the table; `in_sample` at least.
        nominal: errors of nominal odometry.
        lever_m: distance of the wheels from the middle, m.
    """
    on = next(name for name in _KINDS if tables.get(name))
    of = tuple(motion for motion in tables[on] if motion != "mean")
    found = AgainstNominal(on, _mean(nominal, tables[on]), tables[on]["mean"], None, lever_m, of)
    motions = tables.get("leave_one_motion_out")
    if not motions or on == "leave_one_motion_out":
        return found
    other = replace(found, result=motions["mean"])
    return found if other.by_m >= found.by_m else replace(found, on_motions=motions["mean"])


def _mean(table: Table, like: Table) -> Row:
    """Mean row of a table over the motions of another one."""
    rows = [table[motion] for motion in like if motion != "mean"]
    return {key: float(np.mean([row[key] for row in rows])) for key in (_POSITION, _HEADING)}


def _errors(row: Row) -> str:
    return f"{1e3 * row[_POSITION]:.2f} mm, {np.degrees(row[_HEADING]):.3f} deg"
