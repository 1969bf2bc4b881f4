"""Keeps the force of a fan while its battery sags and no bench runs: the duty rises as the voltage falls.

Two measurements must agree. The duty is raised only while voltage times duty *and* the speed have fallen
since the fan settled, and lowered, never below the set-point, only when both have risen. The median of some
reports counts for both: one report that is wrong changes nothing, also not as the one that is compared with.
"""

from collections import deque
from collections.abc import Collection, Mapping

from hil.core.clock import nanoseconds

_SETTLED_NS = nanoseconds(2.0)
_REPORTS = 5
"""Number of reports of voltage and speed whose median counts: a second of those of the voltage."""
_TOLERANCE, _MOST = 0.003, 0.02
_SAGS_SHARE = 0.02
"""Share of the speed that is missing at the highest set-point before the daemon says so."""


class VoltageTrim:
    """The factor on the set-point of one fan.

    Attributes:
        lift: factor on the duty, at least 1.
        sag: shortfall in spite of the highest set-point, in words; empty for none.
    """

    def __init__(self) -> None:
        self._volts: deque[float] = deque(maxlen=_REPORTS)
        self._speeds: deque[float] = deque(maxlen=_REPORTS)
        self.begin()

    def begin(self) -> None:
        """Begin anew with another set-point."""
        self._since_ns: int | None = None
        self._kept: tuple[float, float] | None = None
        self.lift, self.sag = 1.0, ""

    def take(
        self, t_ns: int, values: Mapping[str, float], sent: float, target: float, highest: float
    ) -> None:
        """Take a report of the fan while a duty is kept.

        Args:
            t_ns: time of the report.
            values: figures of the report by name; those with a voltage lead to a new factor.
            sent: present duty.
            target: duty of the set-point.
            highest: highest duty.
        """
        if "erpm" in values:
            self._speeds.append(values["erpm"])
        if "input_v" not in values:
            return
        self._volts.append(values["input_v"])
        if sent < min(target * self.lift, highest) * (1.0 - _TOLERANCE):
            self._since_ns = None
            return
        self._since_ns = t_ns if self._since_ns is None else self._since_ns
        volts, erpm = _middle(self._volts), _middle(self._speeds)
        if t_ns - self._since_ns < _SETTLED_NS or volts <= 0.0 or erpm <= 0.0:
            return
        if self._kept is None:
            self._kept = volts * sent, erpm
            return
        missing = self._kept[0] / (volts * sent) - 1.0, self._kept[1] / erpm - 1.0
        change = 0.0
        if min(missing) > _TOLERANCE:
            change = min(*missing, _MOST)
        elif max(missing) < -_TOLERANCE:
            change = max(*missing, -_MOST)
        self.lift = max(self.lift * (1.0 + change), 1.0)
        at_most = target * self.lift >= highest
        self.lift = min(self.lift, max(highest / target, 1.0))
        sags = at_most and min(missing) > _SAGS_SHARE
        self.sag = ""
        if sags:
            self.sag = (
                f"the battery sags to {volts:.1f} V: at the highest duty the fan turns "
                f"{100.0 * min(missing):.0f} % slower than when it was set; bring the robot down, or change "
                "the battery"
            )


def _middle(values: Collection[float]) -> float:
    """Median of the values; 0 for none."""
    return sorted(values)[len(values) // 2] if values else 0.0
