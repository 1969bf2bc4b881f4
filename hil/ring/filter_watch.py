"""What the estimator could not believe: a sensor whose samples it refused until it had to begin anew with it.

Deterministic: depends on the states seen since `reset` and on nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from hil.vocabulary.signals import Event, RobotState

_SENSORS: Mapping[str, tuple[str, str]] = {
    "wheels": ("servos", "what camera and IMU tell"), "tracker": ("tracker", "what servos and IMU tell"),
}  # fmt: skip
"""By what the filter calls samples: their device, and what they are held against."""


class FilterWatch:
    """Follows the estimate of one run."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget what was refused."""
        self._before: dict[str, tuple[float, float]] = {}

    def judge(self, state: RobotState, events: list[Event]) -> None:
        """Look at one cycle's estimate; what is noticed is added to `events`.

        A camera's frame that began anew because a pose has leapt refused nothing, and its driver tells of it.
        """
        figures = state.diagnostics
        for name, (device, others) in _SENSORS.items():
            begun, refused = figures.get(f"reanchored_{name}", 0.0), figures.get(f"rejected_{name}", 0.0)
            before = self._before.get(name, (0.0, 0.0))
            self._before[name] = (begun, refused)
            if begun > before[0] and refused > before[1]:
                sigma_mm = 1e3 * math.sqrt(max(*state.covariance.diagonal()[:2].tolist(), 0.0))
                said = f"did not fit {others} for long: the estimate is unsure by {sigma_mm:.1f} mm now"
                events.append(Event(state.t_ns, "warning", device, said))
