"""Rauch-Tung-Striebel smoothing of a whole recording: every pose given all samples, before and after it.

In the form of Bryson and Frazier: instead of inverting predicted covariances, which are singular where a
pose was just cloned, it carries what the later samples say (a vector and a matrix) backwards through every
update, clone and prediction of the extended Kalman filter. Both forms give the same result on a linear
model (tests hold it against the batch solution). Offline only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.estimator import layout as L
from hil.estimator.compiled import compiled
from hil.estimator.fusion import start_of
from hil.estimator.intake import Intake
from hil.estimator.process import advance_linear, anchor_matrix, transition
from hil.estimator.replay import Ints, admit, innovations, moments, run
from hil.estimator.sensors import jacobian, observe
from hil.robot.kinematics import WheelGeometry
from hil.vocabulary.geometry import Array
from hil.vocabulary.signals import Measurements, RobotState

_SEGMENT = 512


def smooth(
    config: EstimatorConfig,
    geometry: WheelGeometry,
    surface: str,
    measurements: Sequence[Measurements],
    start: RobotState,
) -> tuple[RobotState, ...]:
    """Smoothed states at the cycles' times.

    Args:
        config: of the filter; `kind` and `engine` do not matter, the forward pass is the compiled EKF.
        geometry: calibrated wheel parameters.
        surface: `wall` or `floor`.
        measurements: one run from its first cycle.
        start: state that the run was started from.

    Returns:
        One state per cycle, with pose, twist and their covariance; no diagnostics.
    """
    linear = config.model_copy(update={"kind": "ekf"})
    par = L.parameters(linear, surface)
    wheels, rows = L.wheel_tables(linear, geometry)
    tape = _Tape(*_ordered(linear, measurements, start.t_ns), start.t_ns)
    begins = [start_of(linear, surface, start)]
    for segment in tape.segments():
        x, p, m = segment.forward(*begins[-1], par, wheels, rows)
        begins.append((x[-1].copy(), p[-1].copy(), m[-1].copy()))
    late, spread = np.zeros(L.STATES), np.zeros((L.STATES, L.STATES))
    states: list[RobotState] = []
    for segment, begin in zip(reversed(tape.segments()), reversed(begins[:-1]), strict=True):
        x, p, m = segment.forward(*begin, par, wheels, rows)
        xs, ps = np.zeros_like(x), np.zeros((len(x), 6, 6))
        backward(
            segment.zero_ns, segment.t_ns, segment.kinds, segment.data, x, p, m, par, wheels, rows,
            late, spread, xs, ps,
        )  # fmt: skip
        for k in reversed(np.flatnonzero(segment.kinds[1:] == L.RESET) + 1):
            states.append(RobotState(int(segment.t_ns[k]), xs[k, :3].copy(), xs[k, 3:6].copy(), ps[k].copy()))
    return tuple(reversed(states))


def _ordered(
    config: EstimatorConfig, measurements: Iterable[Measurements], start_ns: int
) -> tuple[Ints, Array]:
    """Every usable sample once, and a mark per cycle, in the filter's total order (NaN after all numbers).

    Returns:
        (n, 3) stamps, sensor ids, sequence numbers; (n, 16) event rows.
    """
    intake, nothing = Intake(config), np.zeros((1, L.ROW_DATA))
    found: list[tuple[int, ...]] = []
    rows = [nothing[:0]]
    for m in measurements:
        s = intake.stage(m, start_ns)
        found += zip(*(a[: s.count].tolist() for a in (s.t_ns, s.kinds, s.seqs)), strict=True)
        found.append((m.t_ns, L.RESET, m.cycle))
        rows += [s.rows[: s.count].copy(), nothing]
    keys, data = np.array(found, dtype=np.int64).reshape(-1, 3), np.concatenate(rows)
    order = np.lexsort((*data.T[::-1], *keys.T[::-1]))
    keys, data = keys[order], data[order]
    both = (data[1:] == data[:-1]) | (np.isnan(data[1:]) & np.isnan(data[:-1]))
    fresh = np.ones(len(keys), dtype=np.bool_)
    fresh[1:] = ~(both.all(axis=1) & (keys[1:] == keys[:-1]).all(axis=1))
    return keys[fresh], data[fresh]


class _Segment:
    """A stretch of events; row 0 is the one before it."""

    def __init__(self, zero_ns: int, t_ns: Ints, kinds: Ints, data: Array) -> None:
        self.zero_ns, self.t_ns, self.kinds, self.data = zero_ns, t_ns, kinds, data

    def forward(
        self, x0: Array, p0: Array, m0: Array, par: Array, wheels: Array, rows: Array
    ) -> tuple[Array, Array, Array]:
        """States, covariances and memories after each event, the one before it included."""
        n = len(self.t_ns)
        x, p, m = np.empty((n, L.STATES)), np.empty((n, L.STATES, L.STATES)), np.empty((n, L.MEMORY))
        x[0], p[0], m[0] = x0, p0, m0
        run(0, 1, n, self.zero_ns, self.t_ns, self.kinds, self.data, x, p, m, par, wheels, rows)
        return x, p, m


class _Tape:
    """All events of a run."""

    def __init__(self, keys: Ints, data: Array, start_ns: int) -> None:
        self._zero_ns = start_ns
        self._t_ns, self._kinds = np.r_[start_ns, keys[:, 0]], np.r_[L.RESET, keys[:, 1]]
        self._data = np.concatenate([np.zeros((1, L.ROW_DATA)), data])

    def segments(self) -> list[_Segment]:
        """The run in stretches whose states fit in memory; neighbours share one event."""
        return [
            _Segment(self._zero_ns, self._t_ns[k : k + _SEGMENT + 1], self._kinds[k : k + _SEGMENT + 1],
                     self._data[k : k + _SEGMENT + 1])
            for k in range(0, len(self._t_ns) - 1, _SEGMENT)
        ]  # fmt: skip


@compiled
def pull_update(
    kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array, par: Array, wheels: Array, rows: Array,
    accepted: int, late: Array, spread: Array,
) -> None:  # fmt: skip
    """Carry what later samples say back through one sample's update, row by row in reverse, in place.

    Args:
        kind: sensor id.
        t_ns: stamp since the start.
        x: (20,) predicted state.
        p: (20, 20) its covariance.
        m: (72,) memory before the sample; used up.
        data: (16,) event row.
        par: `layout.parameters`.
        wheels: (6, 4), and
        rows: (8, 11), of `layout.wheel_tables`.
        accepted: number of rows that the forward pass used.
        late: (20,) and
        spread: (20, 20): smoothed state = x - p late, smoothed covariance = p - p spread p.
    """
    z, var, aux = np.zeros(L.ROWS), np.zeros(L.ROWS), np.zeros(2)
    count = observe(kind, t_ns, m, data, par, wheels, rows, z, var, aux)
    if count == 0 or accepted == 0:
        return
    mean = np.zeros(L.ROWS)
    cross, own = np.zeros((L.STATES, L.ROWS)), np.zeros((L.ROWS, L.ROWS))
    moments(kind, x, p, aux, par, rows, count, mean, cross, own)
    h = np.zeros((L.ROWS, L.STATES))
    jacobian(kind, x, aux, par, rows, h)
    nu = innovations(kind, z, mean, var, count)
    size, used = np.zeros(L.ROWS), np.zeros(L.ROWS)
    for i in range(count):
        size[i] = own[i, i] + var[i]
        whole = kind == L.TRACKER or kind == L.MOCAP
        if var[i] < 0.0 or not size[i] > 0.0 or (nu[i] * nu[i] / size[i] > par[L.GATE1] and not whole):
            continue
        used[i] = 1.0
        for j in range(i + 1, count):
            gain = own[j, i] / size[i]
            nu[j] -= gain * nu[i]
            cross[:, j] -= gain * cross[:, i]
            for k in range(i + 1, count):
                own[j, k] -= gain * own[i, k]
    for i in range(count - 1, -1, -1):
        if used[i] > 0.0:
            back = np.eye(L.STATES) - np.outer(cross[:, i] / size[i], h[i])
            late[:] = back.T @ late - h[i] * (nu[i] / size[i])
            spread[:, :] = back.T @ spread @ back + np.outer(h[i], h[i]) / size[i]


@compiled
def pull_anchor(x: Array, data: Array, par: Array, late: Array, spread: Array) -> None:
    """Carry back through a new frame of the camera, set at state x."""
    heading = x[2] - data[2]
    size = 1.0 + par[L.CAMERA_SCALED] * x[12]
    c, s = np.cos(heading), np.sin(heading)
    rx, ry = (c * data[0] - s * data[1]) / size, (s * data[0] + c * data[1]) / size
    a = anchor_matrix(rx, ry, size, par[L.CAMERA_SCALED])
    late[:] = a.T @ late
    spread[:, :] = a.T @ spread @ a


@compiled
def pull_clone(late: Array, spread: Array) -> None:
    """Carry back through the cloning of the pose at a servo read."""
    g = np.eye(L.STATES)
    for i in range(3):
        g[L.CLONE + i, L.CLONE + i] = 0.0
        g[L.CLONE + i, i] = 1.0
    late[:] = g.T @ late
    spread[:, :] = g.T @ spread @ g


@compiled
def backward(
    zero_ns: int, t_ns: Ints, kinds: Ints, data: Array, x: Array, p: Array, m: Array, par: Array,
    wheels: Array, rows: Array, late: Array, spread: Array, xs: Array, ps: Array,
) -> None:  # fmt: skip
    """Backward pass over one stretch; `late` and `spread` go on to the one before it.

    Args:
        zero_ns: stamp that sensor memory counts from.
        t_ns: (n,) stamps; row 0 of every array is the event before the stretch.
        kinds: (n,) sensor ids.
        data: (n, 16) event rows.
        x: (n, 20) states of the forward pass after each event.
        p: (n, 20, 20) their covariances.
        m: (n, 72) sensor memories.
        par: `layout.parameters`.
        wheels: (6, 4), and
        rows: (8, 11), of `layout.wheel_tables`.
        late: (20,) and
        spread: (20, 20), see `pull_update`; changed in place.
        xs: (n, 20) and
        ps: (n, 6, 6), filled at the cycles' marks with smoothed states and the covariance of pose and twist.
    """
    for k in range(t_ns.shape[0] - 1, 0, -1):
        dt_s = (t_ns[k] - t_ns[k - 1]) * 1e-9
        kind, stamp = kinds[k], float(t_ns[k] - zero_ns)
        use = 0
        if kind == L.RESET:
            xs[k] = x[k] - p[k] @ late
            ps[k] = (p[k] - p[k] @ spread @ p[k])[:6, :6]
        else:
            use = admit(kind, stamp, m[k - 1], data[k], par)
        if use == 1 or use == 2:
            before, spread_before = x[k - 1].copy(), p[k - 1].copy()
            if dt_s > 0.0:
                advance_linear(before, spread_before, dt_s, par)
            tracker = kind == L.TRACKER
            again = m[k, L.REANCHORED + L.TRACKER] > m[k - 1, L.REANCHORED + L.TRACKER]
            if kind == L.WHEELS:
                pull_clone(late, spread)
            elif tracker and (use == 2 or again or m[k, L.FRAME_T] == stamp):
                pull_anchor(x[k], data[k], par, late, spread)
            if use == 1:
                slot = L.ACCEPTED + kind
                accepted = int(m[k, slot] - m[k - 1, slot])
                if kind == L.GYRO:
                    accepted += int(m[k, L.ACCEPTED + L.GRAVITY] - m[k - 1, L.ACCEPTED + L.GRAVITY])
                pull_update(
                    kind, stamp, before, spread_before, m[k - 1].copy(), data[k], par, wheels, rows,
                    accepted, late, spread,
                )  # fmt: skip
        if dt_s > 0.0:
            f = transition(x[k - 1], dt_s, par[L.SLIP_S])
            late[:] = f.T @ late
            spread[:, :] = f.T @ spread @ f
