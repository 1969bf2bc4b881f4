"""Reports sensors that the estimator has rejected for long, that fit badly on average, or that are noisy.

An estimate that fits neither camera nor wheels is wrong: the robot stops, as nothing corrects the estimate.
Deterministic: depends only on the states since `reset`.
"""

import math

from hil.core.signals import WHEELS, Event, RobotState
from hil.loop.cycle_data import Check, Cycle

_MOST, _CALM = 2.5, 1.5
"""Mean normalised innovation squared at which a warning is given, and below which it may be given again;
sensors without a fault stay below 1.2 on both plants."""
_READS, _REJECTED = 100, 1.0
"""Reads of the servos that are judged together, and rejected wheels per read at which a warning is given;
healthy servos have 0.3 at most."""
_NEITHER, _IN_A_ROW = 6.0, 20
"""Mean NIS of the camera, and number of reads without a wheel that fits, from which on an estimate stops the
robot. The noise of a camera is no reason: the estimator measures it."""
_EACH = tuple(f"rejected_wheel_{wheel.lower()}" for wheel in WHEELS)
"""Diagnostics of the estimator that count the rejected equations of each wheel."""
_NOISES = {
    "tracker": ("noise_tracker_x", "noise_tracker_y", "noise_tracker_heading"),
    "imu": ("noise_gyro", "noise_gravity"),
}
"""Diagnostics of the estimator that hold factors on the variances of a device."""
_LASTING = 100
"""Number of estimates after which a device that is too noisy is reported: the factor is then good to 10 %."""


class _WheelReads:
    """Counts the wheels that the filter rejects, in each `_READS` reads of the servos.

    Attributes:
        in_a_row: number of reads up to now in which no wheel fits.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the counts."""
        self._reads, self._before, self._rejected, self._often, self.in_a_row = 0, 0.0, 0.0, False, 0
        self._each = (0.0,) * len(WHEELS)

    def judge(self, reads: int, state: RobotState, events: list[Event]) -> None:
        """Report servos whose wheels are rejected often, once until they fit again.

        Args:
            reads: number of reads in this cycle.
            state: the estimate.
            events: list that receives findings.
        """
        figures, before = state.diagnostics, self._each
        rejected = figures.get("rejected_wheels", 0.0)
        now, self._before = max(rejected - self._before, 0.0), rejected
        self._each = tuple(figures.get(name, 0.0) for name in _EACH)
        if reads:
            none = all(now > then for now, then in zip(self._each, before, strict=True))
            self.in_a_row = self.in_a_row + reads if none else 0
        self._rejected, self._reads = self._rejected + now, self._reads + reads
        if self._reads < _READS:
            return
        often, reported = self._rejected >= _REJECTED * self._reads, self._often
        if often and not reported:
            share = 100.0 * self._rejected / (len(WHEELS) * self._reads)
            message = (
                f"{share:.0f} % of the wheels' angles of the last {self._reads} reads do not fit the others: "
                "their data are old or irregular, or the wheels slip"
            )
            events.append(Event(state.t_ns, "warning", "servos", message))
        self._reads, self._rejected, self._often = 0, 0.0, often


class _Refusals:
    """Counts how often the filter has rejected a sensor, and re-anchored its frame.

    Args:
        name: name of its samples in the filter.
        device: kind of the sensor.
        others: text on the sensors that its samples are compared with.
    """

    def __init__(self, name: str, device: str, others: str) -> None:
        self._began, self._refused = f"reanchored_{name}", f"rejected_{name}"
        self._device, self._others = device, others
        self.reset()

    def reset(self) -> None:
        """Clear the counts."""
        self._before = (0.0, 0.0)

    def news(self, state: RobotState, events: list[Event]) -> tuple[bool, bool]:
        """Whether its frame was re-anchored in this cycle, and whether a sample was rejected."""
        figures, before = state.diagnostics, self._before
        counts = figures.get(self._began, 0.0), figures.get(self._refused, 0.0)
        if counts == before:
            return False, False
        self._before = counts
        anew, refused = counts[0] > before[0], counts[1] > before[1]
        if anew and refused:
            sigma_mm = 1e3 * math.sqrt(max(*state.covariance.diagonal()[:2].tolist(), 0.0))
            said = f"did not fit {self._others} for long: the estimate is unsure by {sigma_mm:.1f} mm now"
            events.append(Event(state.t_ns, "warning", self._device, said))
        return anew, refused


class _Noise:
    """Reports sensors that the estimator has found noisier than it was told, once per run."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the counts."""
        self._lasting = dict.fromkeys(_NOISES, 0)

    def judge(self, state: RobotState, events: list[Event]) -> None:
        """Check one cycle's estimate; adds findings to `events`."""
        figures = state.diagnostics
        for device, names in _NOISES.items():
            factor = max(figures.get(name, 1.0) for name in names)
            if factor > 1.0 and self._lasting[device] < _LASTING:
                self._lasting[device] += 1
                if self._lasting[device] == _LASTING:
                    said = (
                        f"{math.sqrt(factor):.1f} times as noisy as [estimator] says, and believed less by "
                        "that: measure its noise (`hil run sensor_noise`)"
                    )
                    events.append(Event(state.t_ns, "warning", device, said))


class FilterFit(Check):
    """Checks the estimate of one run."""

    def __init__(self) -> None:
        self._reads = _WheelReads()
        self._wheels = _Refusals("wheels", "servos", "camera and IMU")
        self._camera = _Refusals("tracker", "tracker", "servos and IMU")
        self._noise = _Noise()
        self.reset()

    def reset(self) -> None:
        """Clear the counts."""
        self._reads.reset()
        self._wheels.reset()
        self._camera.reset()
        self._noise.reset()
        self._misfit, self._largest_m, self._mean = False, 0.0, 1.0
        self._off = (0.0, 0.0)

    def take_inflation(self) -> tuple[float, float]:
        """Estimate error found since the last call (m, rad); resets it."""
        off, self._off = self._off, (0.0, 0.0)
        return off

    def on_estimate(self, cycle: Cycle) -> None:
        """Check for rejected samples, and for the fit of the camera's poses."""
        assert cycle.state is not None
        self._reads.judge(len(cycle.measurements.wheels), cycle.state, cycle.events)
        self.judge(cycle.state, cycle.events)
        self._check_neither(cycle, cycle.state.diagnostics.get("nis_mean_tracker", 1.0))
        cycle.inflate_next(self.take_inflation())

    def _check_neither(self, cycle: Cycle, misfit: float) -> None:
        """Stop where neither the wheels nor the camera, with its mean NIS `misfit`, fit the estimate."""
        if misfit > _NEITHER and self._reads.in_a_row >= _IN_A_ROW:
            said = (
                f"the estimate fits neither the camera (mean NIS {misfit:.1f}, expected 1) nor the wheels: "
                "it cannot be right. Measure what [estimator] says (`hil run sensor_noise`)"
            )
            cycle.stop("sensors_disagree", said, ("tracker", "servos", "imu"))

    def judge(self, state: RobotState, events: list[Event]) -> None:
        """Check one cycle's estimate; adds findings to `events`.

        A camera frame that was re-anchored after a pose jump without rejected samples is reported by the
        driver.
        """
        self._wheels.news(state, events)
        self._noise.judge(state, events)
        self._judge_fit(state, events, *self._camera.news(state, events))

    def _judge_fit(self, state: RobotState, events: list[Event], anew: bool, refused: bool) -> None:
        """Check the mean fit of the camera's poses: each may pass the gate although their mean does not fit.

        A series of rejected poses leads to a new frame, which discards them: `_Refusals` reports that.

        Args:
            state: the estimate.
            events: list that receives findings.
            anew: True if the camera's frame was re-anchored in this cycle.
            refused: True if one of its poses was rejected in this cycle.
        """
        figures = state.diagnostics
        misfit, before = figures.get("nis_mean_tracker", 1.0), self._mean
        self._mean = misfit
        innovation_m = figures.get("innovation_tracker_m", 0.0)
        if innovation_m > self._largest_m:
            self._largest_m = innovation_m
        if anew or misfit < _CALM:
            self._misfit, self._largest_m = anew, 0.0
        if misfit == before or refused or self._misfit:  # unchanged: no new pose
            return
        if misfit > _MOST:
            self._misfit, self._off = True, (self._largest_m, 0.0)
            said = (
                f"camera and wheels do not fit (mean NIS {misfit:.1f}, expected 1): one of them is late or "
                f"wrong; the estimate is unsure by {1e3 * self._largest_m:.1f} mm more"
            )
            events.append(Event(state.t_ns, "warning", "tracker", said))
