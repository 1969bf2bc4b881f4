"""Weight that the accelerometer feels of a robot after its stop: whether it is pressed on, and at rest."""

from collections import deque

import numpy as np

from hil.core.signals import ImuSample
from hil.robot.statics import GRAVITY_M_S2

_CALM_M_S2 = 2.0
"""Largest difference of the median specific force from gravity; data sheets allow 0.8."""
_FELT = 10
"""Number of specific-force samples in the median."""


class FeltWeight:
    """Compares the specific force with gravity.

    Args:
        lightest_m_s2: specific force below which adhesion counts as lost, m/s^2.
    """

    def __init__(self, lightest_m_s2: float) -> None:
        self._lightest_m_s2 = lightest_m_s2
        self._felt_m_s2: deque[float] = deque(maxlen=_FELT)

    def begin(self) -> None:
        """Forget the samples of an earlier check."""
        self._felt_m_s2.clear()

    def felt(self, sample: ImuSample) -> None:
        """Store the specific force of a sample."""
        self._felt_m_s2.append(float(np.linalg.norm(sample.specific_force_m_s2)))

    def falls(self) -> bool:
        """Whether the newest sample has clearly less than the weight."""
        return bool(self._felt_m_s2) and self._felt_m_s2[-1] < self._lightest_m_s2

    def doubt(self) -> str:
        """Why the accelerometer contradicts a robot at rest; empty if it does not."""
        felt = self._felt_m_s2
        if self.falls():
            return "the accelerometer feels less than the weight: adhesion is lost"
        middle = float(np.median(felt)) if len(felt) == _FELT else GRAVITY_M_S2
        if abs(middle - GRAVITY_M_S2) > _CALM_M_S2:
            return f"the accelerometer feels {middle:.1f} m/s^2 in place of 9.8: the robot is speeding up"
        return ""
