"""Measures noise and drift of each sensor from runs in which the robot rests and drives.

Motion capture is the reference for camera and gyro. Its own noise is its scatter about a smooth curve, at
rest and in motion. Four wheels measure three quantities: their noise is the contradiction between them. Where
a figure contains another sensor's noise, that noise is subtracted. Only measurements enter, nothing from a
configuration.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.core.geometry import Array, rotation2
from hil.core.signals import Measurements
from hil.estimator.sample_statistics import (
    Change,
    Spread,
    about_a_line,
    blocks,
    by_third_differences,
    hardest,
    random_walk,
    total,
    usual,
)
from hil.robot.kinematics import WheelGeometry

REST_M_S, MOVING_M_S = 1e-3, 5e-3
"""The robot rests below the first speed and drives above the second; between them it starts or stops."""
_HOLE_S = 0.05
_BEST_QUALITY = 3
_WHITE_S, _GYRO_S, _DRIFT_S = 0.2, 0.8, 0.5
_WAY_M = 0.05
_ENDS = 5
_MOTION_S = 0.2
_HARDEST = 0.1
"""Share of a drive with the largest changes of speed: starts and stops, where wheels must not be rejected."""
_ROWS_FREE = 5.0
"""Degrees of freedom of eight wheel equations for three unknowns."""
Runs = Sequence[Sequence[Measurements]]
Step = tuple[Array, Array, float, float, bool | None]


class RunSamples:
    """Samples of one run as arrays; times in s since the run's first cycle."""

    def __init__(self, cycles: Sequence[Measurements], geometry: WheelGeometry) -> None:
        self._zero_ns = cycles[0].t_ns if cycles else 0
        self.gyro = self._rows(
            (s.stamp.t_ns, s.yaw_rate_rad_s) for m in cycles for s in m.gyro if np.isfinite(s.yaw_rate_rad_s)
        )
        self.camera, self.truth = (
            self._rows(
                (s.stamp.t_ns, *s.pose)
                for m in cycles
                for s in getattr(m, name)
                if s.valid and s.quality >= least and np.isfinite(s.pose).all()
            )
            for name, least in (("tracker", _BEST_QUALITY), ("mocap", 0))
        )
        self.wheels = self._rows(
            (s.stamp.t_ns, *s.wheel_angle_rad, *s.steering_rad)
            for m in cycles
            for s in m.wheels
            if all(s.valid)
        )
        self.steps = steps(self.wheels, geometry)

    def _rows(self, samples: Iterator[tuple[float, ...]]) -> Array:
        """Samples as rows (n, k) by rising time; the first column is the time in s."""
        rows = [(1e-9 * (t_ns - self._zero_ns), *values) for t_ns, *values in samples]
        if not rows:
            return np.zeros((0, 9))
        table = np.array(rows, dtype=np.float64)
        return table[np.unique(table[:, 0], return_index=True)[1]]

    def rests(self, begin_s: float, end_s: float) -> bool | None:
        """Whether the robot rested during the whole span; None where it started or stopped, or is unknown."""
        inside = self.steps[(self.steps[:, 0] >= begin_s) & (self.steps[:, 0] <= end_s)]
        if len(inside) < 2:
            return None
        slow, *_, fast = sorted(speed(half) for half in np.array_split(inside, 2))
        if fast < REST_M_S:
            return True
        return False if slow > MOVING_M_S else None

    def true_poses(self, t_s: Array) -> Array:
        """Motion-capture poses (n, 3) interpolated to times (n,); NaN outside the data and in gaps."""
        if len(self.truth) < 2:
            return np.full((len(t_s), 3), np.nan)
        at_s = self.truth[:, 0]
        after = np.clip(np.searchsorted(at_s, t_s), 1, len(at_s) - 1)
        near = (at_s[after] - at_s[after - 1] < _HOLE_S) & (t_s >= at_s[0]) & (t_s <= at_s[-1])
        poses = np.column_stack([np.interp(t_s, at_s, self.truth[:, k]) for k in (1, 2, 3)])
        return np.where(near[:, None], poses, np.nan)


def steps(wheels: Array, geometry: WheelGeometry) -> Array:
    """Displacements between servo reads, (n, 11): time s, duration s, mean wheel way m, 8 wheel vectors m."""
    if len(wheels) < 2:
        return np.zeros((0, 11))
    dt = np.diff(wheels[:, 0])
    length = np.diff(wheels[:, 1:5], axis=0) * geometry.radius_m
    steering = np.unwrap(wheels[:, 5:9], axis=0)
    heading = 0.5 * (steering[1:] + steering[:-1]) - geometry.steering_zero_rad
    u = np.stack([length * np.cos(heading), length * np.sin(heading)], axis=-1).reshape(-1, 8)
    return np.column_stack([wheels[1:, 0], dt, np.abs(length).mean(axis=1), u])


def speed(steps: Array) -> float:
    """Speed of the body over steps (n, 11), m/s, from the sum of the wheel vectors.

    In the sum of the vectors the noise averages out, unlike in the sum of their lengths.
    """
    way = steps[:, 3:11].sum(axis=0).reshape(4, 2)
    return float(np.hypot(way[:, 0], way[:, 1]).max() / steps[:, 1].sum())


@dataclass
class Spreads:
    """Variance of one quantity, at rest and in motion."""

    rest: Spread = field(default_factory=Spread)
    moving: Spread = field(default_factory=Spread)

    def add(self, found: Spread, *, moving: bool) -> None:
        """Add the variance of one more block."""
        if moving:
            self.moving = self.moving + found
        else:
            self.rest = self.rest + found

    @property
    def both(self) -> Spread:
        """Variance to use: that in motion where the intervals do not overlap, else the pooled one."""
        (_, low, high), (_, rest_low, rest_high) = self.moving.sigma(), self.rest.sigma()
        return self.moving if low > rest_high or high < rest_low else self.rest + self.moving


@dataclass
class SensorNoise:
    """Measured noise, each a variance; empty where the runs contain no information.

    Attributes:
        gyro: white noise of one rate, rad^2/s^2.
        camera_position, camera_heading: white noise of one pose, m^2 per axis and rad^2.
        camera_walk, camera_creep: drift of the camera's position, m^2 per metre, and m^2 per second at rest.
        camera_turn: drift of the camera's heading, rad^2 per second.
        mocap_position, mocap_heading: white noise of one pose, m^2 per axis and rad^2.
        wheel_step: noise of a wheel's displacement between two reads, m^2 per component.
        wheel_walk: random slip of one wheel, m^2 per rolled metre.
        push, twist: changes of the body's speed, not sensor noise, m^2/s^3 per axis and rad^2/s^3: `push`
            in the tenth with the largest changes, `twist` in the median.
    """

    gyro: Spreads = field(default_factory=Spreads)
    camera_position: Spreads = field(default_factory=Spreads)
    camera_heading: Spreads = field(default_factory=Spreads)
    camera_walk: Spread = field(default_factory=Spread)
    camera_creep: Spread = field(default_factory=Spread)
    camera_turn: Spread = field(default_factory=Spread)
    mocap_position: Spreads = field(default_factory=Spreads)
    mocap_heading: Spreads = field(default_factory=Spreads)
    wheel_step: Spreads = field(default_factory=Spreads)
    wheel_walk: Spread = field(default_factory=Spread)
    push: Spread = field(default_factory=Spread)
    twist: Spread = field(default_factory=Spread)


def measure(runs: Runs, geometry: WheelGeometry) -> SensorNoise:
    """Measure the noise of all sensors in runs of cycles; comparisons with motion capture cover its span."""
    found = SensorNoise()
    every = [RunSamples(cycles, geometry) for cycles in runs]
    for run in every:
        _mocap(run, found)
    for run in every:
        _gyro(run, found)
        _camera(run, found)
        _wheels(run, found, geometry)
    _camera_drift(every, found)
    _wheel_walk(every, found, geometry)
    _motion(every, found)
    return found


def _mocap(run: RunSamples, found: SensorNoise) -> None:
    """White noise of motion capture, by third differences."""
    for part in blocks(run.truth[:, 0], _DRIFT_S):
        t_s, poses = run.truth[part, 0], run.truth[part, 1:4]
        rests = run.rests(t_s[0], t_s[-1])
        if rests is None:
            continue
        place = total(by_third_differences(t_s, poses[:, k]) for k in (0, 1))
        found.mocap_position.add(place, moving=not rests)
        found.mocap_heading.add(by_third_differences(t_s, poses[:, 2]), moving=not rests)


def _gyro(run: RunSamples, found: SensorNoise) -> None:
    """White noise of the rate: at rest about a line, in motion against the turn by motion capture.

    In motion, bias and delay are removed first: the constant part, and the part proportional to the change of
    rate.
    """
    whole = []
    for part in blocks(run.gyro[:, 0], _GYRO_S):
        t_s, rate = run.gyro[part, 0], run.gyro[part, 1]
        rests = run.rests(t_s[0], t_s[-1])
        if rests:
            found.gyro.add(about_a_line(t_s, rate), moving=False)
        heading = run.true_poses(t_s[[0, -1]])[:, 2]
        if rests is False and np.isfinite(heading).all():
            turned = float(np.sum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)))
            span_s = t_s[-1] - t_s[0]
            change = float(rate[-_ENDS:].mean() - rate[:_ENDS].mean())
            whole.append((turned - (heading[1] - heading[0]), span_s * span_s / (len(t_s) - 1), change))
    if len(whole) < 5:
        return
    error, weight, change = np.array(whole).T
    late = np.column_stack([np.ones(len(error)), change])
    error = error - late @ np.linalg.lstsq(late, error, rcond=None)[0]
    turned_off = Spread(float(np.sum(error**2)), len(error) - 2.0)
    known = 2.0 * _known(found.mocap_heading)
    found.gyro.add(turned_off.less(known).per(float(weight.mean())), moving=True)


def _known(spreads: Spreads) -> float:
    """Variance of a sensor that serves as reference for another one; 0 where it is unknown."""
    both = spreads.both
    return both.variance if both.freedom >= 1.0 else 0.0


def _camera(run: RunSamples, found: SensorNoise) -> None:
    """White noise of the camera's poses against motion capture."""
    place, turn = (2.0 / 3.0 * _known(s) for s in (found.mocap_position, found.mocap_heading))
    for part in blocks(run.camera[:, 0], _WHITE_S):
        t_s, poses = run.camera[part, 0], run.camera[part, 1:4]
        truth = run.true_poses(t_s)
        rests = run.rests(t_s[0], t_s[-1])
        if rests is None or not np.isfinite(truth).all():
            continue
        away = float(np.mean(truth[:, 2] - poses[:, 2]))
        off = poses[:, :2] @ rotation2(away).T - truth[:, :2]
        white = total(about_a_line(t_s, off[:, k]) for k in (0, 1))
        found.camera_position.add(white.less(place), moving=not rests)
        found.camera_heading.add(about_a_line(t_s, poses[:, 2] - truth[:, 2]).less(turn), moving=not rests)


def _camera_drift(runs: Sequence[RunSamples], found: SensorNoise) -> None:
    """Drift between camera and motion capture from block to block: per way, at rest, and in heading."""
    walk, creep, turn = list[Change](), list[Change](), list[Change]()
    white = [_known(s) for s in (found.camera_position, found.camera_heading)]
    truth = [_known(s) for s in (found.mocap_position, found.mocap_heading)]
    moved = []
    for run in runs:
        before = None
        for part in blocks(run.camera[:, 0], _DRIFT_S):
            t_s, poses = run.camera[part, 0], run.camera[part, 1:4]
            true = run.true_poses(t_s)
            if not np.isfinite(true).all():
                before = None
                continue
            now = (float(t_s.mean()), poses.mean(axis=0), true.mean(axis=0), len(t_s))
            rests = run.rests(t_s[0], t_s[-1])
            if before is not None and now[0] - before[0] < 1.5 * _DRIFT_S:
                moved.append((before, now, rests))
            before = now
    steps = []
    for (t0, a, p, n), (t1, b, q, k), rests in moved:
        size = 1.0 / n + 1.0 / k
        noise = [size * (w + t) for w, t in zip(white, truth, strict=True)]
        turn.append(Change(float((b - a)[2] - (q - p)[2]), noise[1], t1 - t0))
        seen = rotation2(0.5 * float(p[2] + q[2] - a[2] - b[2])) @ (b - a)[:2]
        steps.append((seen, (q - p)[:2], noise[0], t1 - t0, rests))
    for seen, true, noise0, over, rests in _without_scale(steps):
        way = float(np.hypot(*true))
        for k in range(2):
            off = float(seen[k] - true[k])
            if rests:
                creep.append(Change(off, noise0, over))
            elif rests is False:
                walk.append(Change(off, noise0, way))
    found.camera_turn, found.camera_creep = random_walk(turn), random_walk(creep)
    found.camera_walk = random_walk(walk)


def _without_scale(steps: Sequence[Step]) -> Iterator[Step]:
    """Steps of the camera and the true steps times one common scale, which removes a scale error."""
    power = sum(float(true @ true) for _, true, *_ in steps)
    scale = sum(float(true @ seen) for seen, true, *_ in steps) / power if power > 0.0 else 1.0
    for seen, true, *others in steps:
        yield (seen, scale * true, *others)  # type: ignore[misc]


def _wheels(run: RunSamples, found: SensorNoise, geometry: WheelGeometry) -> None:
    """Noise of the wheels: scatter of the wheel vectors about the common body motion, step by step."""
    for part in blocks(run.steps[:, 0], _WHITE_S):
        t_s, off = run.steps[part, 0], _off(run.steps[part, 3:11], geometry)
        rests = run.rests(t_s[0], t_s[-1])
        if rests is None:
            continue
        off = off - off.mean(axis=0)
        freedom = _ROWS_FREE * (len(t_s) - 1)
        found.wheel_step.add(Spread(float(np.sum(off**2)), freedom), moving=not rests)


def _off(u: Array, geometry: WheelGeometry) -> Array:
    """Wheel vectors (n, 8) less those of the best-fitting body motion."""
    p = geometry.projection()
    return np.asarray(u - u @ (np.linalg.pinv(p).T @ p.T), dtype=np.float64)


def _wheel_walk(runs: Sequence[RunSamples], found: SensorNoise, geometry: WheelGeometry) -> None:
    """Random slip of single wheels: residual of 5 cm steps beyond the noise of their end points.

    A residual that is the same on every metre is systematic for the wheel and does not count as noise.
    """
    squares, ways, freedom = 0.0, 0.0, 0.0
    ends = _known(found.wheel_step)
    for run in runs:
        rolled = np.cumsum(run.steps[:, 2])
        if not len(rolled) or rolled[-1] < 4.0 * _WAY_M:
            continue
        number = np.floor(rolled / _WAY_M).astype(np.int64)
        last = np.flatnonzero(np.diff(number, append=number[-1] + 1))
        path = np.cumsum(_off(run.steps[:, 3:11], geometry), axis=0)[last]
        way = np.diff(rolled[last])
        off = np.diff(path, axis=0)
        off = off - np.outer(way, off.sum(axis=0) / way.sum())
        share = _ROWS_FREE * (len(way) - 1) / (8.0 * len(way))
        squares += float(np.sum(off**2)) - 8.0 * share * len(way) * ends
        ways += 8.0 * share * float(way.sum())
        freedom += _ROWS_FREE * (len(way) - 1)
    if ways > 0.0:
        found.wheel_walk = Spread(max(squares, 0.0) / ways * freedom, freedom)


def _motion(runs: Sequence[RunSamples], found: SensorNoise) -> None:
    """Random-walk density of speed and yaw rate, from motion capture block by block."""
    push, twist = list[Change](), list[Change]()
    place, turn = _known(found.mocap_position), _known(found.mocap_heading)
    for run in runs:
        middles = []
        for part in blocks(run.truth[:, 0], _MOTION_S):
            middles.append((run.truth[part].mean(axis=0), part.stop - part.start))
        for (a, n), (b, k), (c, m) in zip(middles, middles[1:], middles[2:], strict=False):
            over = 0.5 * float(c[0] - a[0])
            if over > 1.5 * _MOTION_S:
                continue
            change = (c - b)[1:] / (c[0] - b[0]) - (b - a)[1:] / (b[0] - a[0])
            white = (1.0 / n + 4.0 / k + 1.0 / m) / over**2
            push += [Change(float(change[j]), place * white, over) for j in (0, 1)]
            twist.append(Change(float(change[2]), turn * white, over))
    found.push = hardest(push, _HARDEST)
    found.twist = usual(twist)
