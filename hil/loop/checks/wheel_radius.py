"""Finds a wheel whose radius is not that of the bench file, by the body's turn and the drives' currents.

All four wheels are commanded by one motion. A wheel that is smaller than the bench file has it rolls less far
than it is told to: the other three turn the body, and push that wheel, so that its drive carries less than
theirs. The turn alone tells the side and the current alone tells the wheel; where both tell the same, the
radius is wrong. By how much, neither tells: that depends on how far the tyres slip. Creep on a wall, a drive
that runs stiffly and a turned mount show in one of the two only.
Deterministic: depends only on the samples since `reset`.
"""

import math

import numpy as np

from hil.core.geometry import nearest_turn
from hil.core.signals import WHEELS, Event, WheelMeasurement
from hil.loop.checks.dead_reckoning import Track
from hil.loop.checks.wheel_slip import WheelSlipCheck
from hil.loop.cycle_data import Check, Cycle
from hil.robot.kinematics import WheelGeometry

KEY = "robot.wheel_radius_m"
_STEP_NS, _GAP_NS = 58_000_000, 300_000_000
_LEAST_M, _STEPS = 0.08, 15
"""Way and number of steps from which a wheel is judged."""
_TURN_RAD, _TURN_SHARE, _OFF_SHARE = 0.006, 0.05, 0.08
"""Difference of the turns that good sensors may have, addition per radian that the wheels turn, and smallest
deviation of a radius. On a wall the centre of mass turns the body by half of that."""
_APART_A, _APART_SHARE = 0.015, 0.35
"""Current by which one drive differs from the nearest other: least, and as a share of the others' mean."""
_ROLLS_RAD_S = 0.3


class WheelRadiusCheck(Check):
    """Checks the radii of one run.

    Args:
        geometry: wheel geometry.
        wheels: track of the wheels, updated by another check.
        slip: check that finds a wheel that begins to slip: from then on nothing is said about radii.
        drive_sign: sign of each drive, (4,).
    """

    def __init__(
        self, geometry: WheelGeometry, wheels: Track, slip: WheelSlipCheck, drive_sign: tuple[int, ...]
    ) -> None:
        turn = np.linalg.pinv(np.asarray(geometry.projection()))[2].tolist()
        self._turns = list(zip(turn[::2], turn[1::2], strict=True))
        self._radius_m: list[float] = geometry.radius_m.tolist()
        self._zero_rad: list[float] = geometry.steering_zero_rad.tolist()
        self._wheels, self._slip, self._sign = wheels, slip, drive_sign
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._judged = False
        self._last: tuple[int, list[float]] | None = None
        self._compared: tuple[str, int, float, float] | None = None
        self._way_m, self._apart_rad, self._turned_rad, self._steps = 0.0, 0.0, 0.0, 0
        self._by_wheel_rad, self._current_a = [0.0] * 4, [0.0] * 4

    def on_samples(self, cycle: Cycle) -> None:
        """Add a cycle, and judge once the robot has gone far enough."""
        if self._judged or self._slip.reported:
            return
        given = cycle.measurements
        if not given.wheels or not cycle.inputs.servos:
            return
        sample = given.wheels[-1]
        if self._last is not None and 0 <= sample.stamp.t_ns - self._last[0] < _STEP_NS:
            return
        self._roll(sample, cycle.inputs.servos[-1].current_a.tolist())
        for name, poses in (("mocap", given.mocap), ("tracker", given.tracker)):
            if poses and poses[-1].valid:
                self._compare(name, poses[-1].stamp.t_ns, poses[-1].pose.item(2))
                break
        if self._way_m > _LEAST_M and self._steps >= _STEPS:
            self._judge(cycle)

    def _roll(self, sample: WheelMeasurement, currents_a: list[float]) -> None:
        """Add how each wheel has turned the body since the last sample, and its current while it rolls."""
        t_ns, last = sample.stamp.t_ns, self._last
        angles: list[float] = sample.wheel_angle_rad.tolist()
        rates: list[float] = sample.wheel_rate_rad_s.tolist()
        if not (all(sample.valid) and math.isfinite(sum(angles) + sum(currents_a))):
            return
        self._last = (t_ns, angles)
        if last is None or not 0 < t_ns - last[0] < _GAP_NS or min(map(abs, rates)) < _ROLLS_RAD_S:
            return
        self._steps += 1
        for i, (along, across) in enumerate(self._turns):
            rolled_m = (angles[i] - last[1][i]) * self._radius_m[i]
            steering_rad = sample.steering_rad.item(i) - self._zero_rad[i]
            self._by_wheel_rad[i] += rolled_m * (
                along * math.cos(steering_rad) + across * math.sin(steering_rad)
            )
            self._current_a[i] += math.copysign(currents_a[i], currents_a[i] * self._sign[i] * rates[i])
            self._way_m += 0.25 * abs(rolled_m)

    def _compare(self, name: str, t_ns: int, heading_rad: float) -> None:
        """Add the turn by a sensor since its last pose, less that by the wheels."""
        values, before = self._wheels.at(t_ns), self._compared
        if values is None:
            return
        by_wheels = values[1].real
        self._compared = (name, t_ns, heading_rad, by_wheels)
        if before is None or before[0] != name or not 0 < t_ns - before[1] < _GAP_NS:
            return
        turned_rad = by_wheels - before[3]
        self._turned_rad += abs(turned_rad)
        self._apart_rad += nearest_turn(heading_rad, before[2]) - before[2] - turned_rad

    def _judge(self, cycle: Cycle) -> None:
        """Report the wheel that both the turn and the currents tell, if there is one."""
        currents = [total / self._steps for total in self._current_a]
        for i, by_wheel_rad in enumerate(self._by_wheel_rad):
            least_rad = _TURN_RAD + _TURN_SHARE * self._turned_rad + _OFF_SHARE * abs(by_wheel_rad)
            if abs(self._apart_rad) <= least_rad:
                continue
            others = [current for k, current in enumerate(currents) if k != i]
            larger = self._apart_rad * by_wheel_rad > 0.0
            apart_a = currents[i] - max(others) if larger else min(others) - currents[i]
            mean_a = sum(others) / len(others)
            if apart_a > _APART_A + _APART_SHARE * abs(mean_a):
                self._judged = True
                cycle.events.append(self._event(cycle.inputs.t_ns, i, currents[i], mean_a))
                return

    def _event(self, t_ns: int, wheel: int, current_a: float, others_a: float) -> Event:
        by_capture = self._compared is not None and self._compared[0] == "mocap"
        larger = self._apart_rad * self._by_wheel_rad[wheel] > 0.0
        said = (
            f"over {1e3 * self._way_m:.0f} mm the robot turned {1e3 * self._apart_rad:+.0f} mrad more by "
            f"{'motion capture' if by_capture else 'the camera'} than by the wheels, and the drive of wheel "
            f"{WHEELS[wheel]} took {current_a:.3f} A where the others took {others_a:.3f} A: this wheel is "
            f"{'larger' if larger else 'smaller'} than the {1e3 * self._radius_m[wheel]:.1f} mm of {KEY}; "
            "measure it, and look at its hub"
        )
        return Event(t_ns, "warning", "servos", said, key=KEY)
