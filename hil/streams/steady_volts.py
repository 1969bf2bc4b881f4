"""Battery voltage without single damaged reports."""

import math

from hil.robot.motor_cross_checks import far

_LEAP_SHARE = 0.05


class SteadyVolts:
    """A voltage that changes by more than a twentieth only once two reports in a row say so."""

    def __init__(self) -> None:
        self._believed_v = self._candidate_v = math.nan

    def take(self, input_v: float) -> float:
        """Take a report, V; the voltage to be used, V."""
        if not far(input_v, self._believed_v, _LEAP_SHARE) or not far(
            input_v, self._candidate_v, _LEAP_SHARE
        ):
            self._believed_v = input_v
        self._candidate_v = input_v
        return self._believed_v
