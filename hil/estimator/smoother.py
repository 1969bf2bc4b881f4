"""Rauch-Tung-Striebel smoothing of a whole recording: every pose given all samples before and after it.

The form of Bryson and Frazier is used. Predicted covariances are singular where a pose was just cloned, so
they are not inverted. Instead the information of the later samples (a vector and a matrix) is carried
backwards through every update, clone and prediction of the extended Kalman filter. Both forms give the same
result on a linear model (tests compare it with the batch solution). Offline only.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Ints, Records
from hil.core.signals import Measurements, RobotState
from hil.estimator.constant_twist import transition
from hil.estimator.event_loop import run
from hil.estimator.initial_state import start_of
from hil.estimator.kernel_layout import (
    MEMORY,
    PARAMETERS,
    ROW,
    ROW_FLOATS,
    EventRow,
    Events,
    Memory,
    Parameters,
    States,
    first_memory,
    parameters,
)
from hil.estimator.matrix_loops import put, put_rows, seen
from hil.estimator.measurement_queue import MeasurementQueue
from hil.estimator.pose_correction import find_linearisation_point, is_unsure, pull_carry
from hil.estimator.process_model import advance_linear
from hil.estimator.sensors import GATED_TOGETHER, MARK, admit, innovation, jacobian, observe, predicted, undo
from hil.estimator.sensors.sensor import NEW_FRAME, USED
from hil.estimator.sensors.wheels import nominal
from hil.estimator.state_vector import MOTION, POSE, ROWS, STATES, TWIST
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import compile_for, inner, kernel, plain

_SEGMENT = 512


class Later(NamedTuple):
    """Information of later samples on a state x with covariance p.

    Attributes:
        late: (20,): smoothed state = x - p late.
        spread: (20, 20): smoothed covariance = p - p spread p.
    """

    late: Array
    spread: Array


def smooth(
    config: EstimatorConfig,
    geometry: WheelGeometry,
    surface: str,
    measurements: Sequence[Measurements],
    start: RobotState,
) -> tuple[RobotState, ...]:
    """Smoothed states at the times of the cycles.

    Args:
        config: filter configuration; `kind` and `engine` are ignored, the forward pass is the compiled EKF.
        geometry: calibrated wheel parameters.
        surface: `wall` or `floor`.
        measurements: one run from its first cycle.
        start: start state of the run.

    Returns:
        One state per cycle, with pose, twist and their covariance; no diagnostics.
    """
    load_smoother()
    linear = config.model_copy(update={"kind": "ekf"})
    par = parameters(linear, geometry, surface)
    segments = _segments(*_ordered(linear, measurements, start.t_ns), start.t_ns)
    begins = [(*start_of(linear, surface, start), first_memory())]
    for segment in segments:
        x, p, m = segment.forward(*begins[-1], par)
        begins.append((x[-1].copy(), p[-1].copy(), m[-1:].copy()))
    later = Later(np.zeros(STATES), np.zeros((STATES, STATES)))
    states: list[RobotState] = []
    for segment, begin in zip(reversed(segments), reversed(begins[:-1]), strict=True):
        x, p, m = segment.forward(*begin, par)
        xs, ps = np.zeros_like(x), np.zeros((len(x), MOTION, MOTION))
        backward(segment.zero_ns, segment.events, States(x, p, m), par, later, xs, ps)
        for k in reversed(np.flatnonzero(segment.events.numbers[1:] == MARK) + 1):
            pose, twist = xs[k, POSE].copy(), xs[k, TWIST].copy()
            states.append(RobotState(int(segment.events.t_ns[k]), pose, twist, ps[k].copy()))
    return tuple(reversed(states))


@cache
def load_smoother() -> None:
    """Load the compiled code of `backward`, or compile it where none is cached."""
    one, row, square = np.zeros(1, dtype=np.int64), np.zeros((1, STATES)), np.zeros((1, STATES, STATES))
    events = Events(one, one, one, np.zeros(1, ROW))
    states, later = States(row, square, np.zeros(1, MEMORY)), Later(row[0].copy(), square[0].copy())
    par, ps = np.zeros(1, PARAMETERS), np.zeros((1, MOTION, MOTION))
    compile_for(backward, 0, events, states, par, later, row, ps)


def _ordered(
    config: EstimatorConfig, measurements: Iterable[Measurements], start_ns: int
) -> tuple[Ints, Array]:
    """Every usable sample once, and a mark per cycle, in the filter's total order (NaN sorts last).

    Returns:
        (n, 3) stamps, sensor numbers, sequence numbers; (n, floats of a row) event rows.
    """
    intake, nothing = MeasurementQueue(config), np.zeros((1, ROW_FLOATS))
    found: list[tuple[int, ...]] = []
    rows = [nothing[:0]]
    for m in measurements:
        s = intake.stage(m, start_ns)
        found += zip(*(a[: s.count].tolist() for a in s.samples[:3]), strict=True)
        found.append((m.t_ns, MARK, m.cycle))
        rows += [s.samples.data[: s.count].copy(), nothing]
    keys, data = np.array(found, dtype=np.int64).reshape(-1, 3), np.concatenate(rows)
    order = np.lexsort((*data.T[::-1], *keys.T[::-1]))
    keys, data = keys[order], data[order]
    both = (data[1:] == data[:-1]) | (np.isnan(data[1:]) & np.isnan(data[:-1]))
    fresh = np.ones(len(keys), dtype=np.bool_)
    fresh[1:] = ~(both.all(axis=1) & (keys[1:] == keys[:-1]).all(axis=1))
    return keys[fresh], data[fresh]


class _Segment:
    """A segment of the events; row 0 is the event before it."""

    def __init__(self, zero_ns: int, t_ns: Ints, numbers: Ints, rows: Records) -> None:
        self.zero_ns, self.events = zero_ns, Events(np.array([0, len(t_ns), 0, 0]), t_ns, numbers, rows)

    def forward(self, x0: Array, p0: Array, m0: Records, par: Records) -> tuple[Array, Array, Records]:
        """States (n, 20), covariances and memories after each event, including the one before the segment."""
        t_ns = self.events.t_ns
        n = len(t_ns)
        x, p, m = np.empty((n, STATES)), np.empty((n, STATES, STATES)), np.empty(n, MEMORY)
        x[0], p[0], m[0] = x0, p0, m0[0]
        end = States(x0.copy(), p0.copy(), m0.copy())
        run(plain(self.events), plain(States(x, p, m)), 1, self.zero_ns, par, None, t_ns[-1], plain(end))
        return x, p, m


def _segments(keys: Ints, data: Array, start_ns: int) -> list[_Segment]:
    """Split the run into segments whose states fit in memory; neighbours share one event."""
    t_ns, numbers = np.r_[start_ns, keys[:, 0]], np.r_[MARK, keys[:, 1]]
    rows = np.concatenate([np.zeros((1, ROW_FLOATS)), data]).view(ROW)[:, 0]
    cuts = [slice(k, k + _SEGMENT + 1) for k in range(0, len(t_ns) - 1, _SEGMENT)]
    return [_Segment(start_ns, t_ns[cut], numbers[cut], rows[cut]) for cut in cuts]


@inner
def pull_update(
    number: int,
    t_ns: float,
    x: Array,
    p: Array,
    m: Memory,
    sample: tuple[EventRow, Parameters],
    after: Array,
    later: Later,
) -> None:
    """Carry the information of later samples back through one sample's update, row by row, in place.

    Args:
        number: sensor number.
        t_ns: stamp, ns since the start.
        x: (20,) predicted state.
        p: (20, 20) its covariance.
        m: memory before the sample; overwritten.
        sample: the sample's row, and the parameters of all kernels.
        after: (20,) state after the sample.
        later: result of the later step, changed in place.
    """
    (row, par), (late, spread) = sample, later
    w = par.work
    z, var, aux, mean, nu = w.z[:], w.var[:], w.aux[:], w.mean[:], w.nu[:]
    cross, own, h = w.cross[:], w.own[:], w.h[:]
    z[:], var[:], aux[:], mean[:], h[:, :] = 0.0, 0.0, 0.0, 0.0, 0.0
    count = observe(number, t_ns, m, row, par, z, var, aux)
    point = x.copy()
    if is_unsure(number, p):
        find_linearisation_point(number, x, p, count, par, point, p.copy())
    else:
        predicted(number, x, aux, par, mean)
        jacobian(number, x, aux, par, h)
        seen(p, h, count, cross, own)
        innovation(number, z, mean, var, count, nu)
    pull_carry(point, after, late, spread)
    size, used = np.zeros(ROWS), np.zeros(ROWS)
    gate = np.inf if GATED_TOGETHER[number] else par.filter.gate_row
    for i in range(count):
        size[i] = own[i, i] + var[i]
        if var[i] < 0.0 or not size[i] > 0.0 or nu[i] * nu[i] / size[i] > gate:
            continue
        used[i] = 1.0
        for j in range(i + 1, count):
            gain = own[i, j] / size[i]
            nu[j] -= gain * nu[i]
            for k in range(STATES):
                cross[j, k] -= gain * cross[i, k]
            for k in range(i + 1, count):
                own[k, j] -= gain * own[k, i]
    back, information = np.zeros((STATES, STATES)), np.zeros((STATES, STATES))
    for i in range(count - 1, -1, -1):
        if used[i] > 0.0:
            for j in range(STATES):
                for k in range(STATES):
                    back[j, k] = -(cross[i, j] / size[i]) * h[i, k]
                    information[j, k] = h[i, j] * h[i, k] / size[i]
                back[j, j] += 1.0
            put(late, back.T @ late - h[i] * (nu[i] / size[i]))
            put_rows(spread, back.T @ spread @ back + information)
    pull_carry(x, point, late, spread)


@kernel
def backward(
    zero_ns: int, events: Events, states: States, pars: Records, later: Later, xs: Array, ps: Array
) -> None:
    """Backward pass over one segment; afterwards `later` is valid at its start.

    Args:
        zero_ns: stamp that the stamps in sensor memory are relative to.
        events: events of the segment, in order; the first one is the event before it.
        states: states of the forward pass after each event; memories are overwritten.
        pars: (1,) parameters of all kernels.
        later: result of the later step, changed in place.
        xs: (n, 20) filled with smoothed states at the cycles' marks.
        ps: (n, 6, 6) filled there with the smoothed covariance of pose and twist.
    """
    (_, t_ns, numbers, rows), (x, p, m), (late, spread) = events, states, later
    par, rolling = pars[0], np.zeros(2)
    for k in range(t_ns.shape[0] - 1, 0, -1):
        dt_s = (t_ns[k] - t_ns[k - 1]) * 1e-9
        number, stamp = numbers[k], float(t_ns[k] - zero_ns)
        nominal(stamp, x[k - 1], m[k - 1].wheels, par.wheels, rolling)
        if number == MARK:
            put(xs[k], x[k] - p[k] @ late)
            put_rows(ps[k], p[k] - p[k] @ spread @ p[k])
        else:
            use = admit(number, stamp, m[k - 1], rows[k], par)
            if use in (USED, NEW_FRAME):
                undo(number, stamp, x[k], m[k], rows[k], par, late, spread)
            if use == USED and m[k].accepted > m[k - 1].accepted:
                before, spread_before = x[k - 1].copy(), p[k - 1].copy()
                if dt_s > 0.0:
                    advance_linear(before, spread_before, dt_s, par.process, rolling)
                sample = (rows[k], par)
                pull_update(number, stamp, before, spread_before, m[k - 1], sample, x[k], later)
        if dt_s > 0.0:
            f = transition(x[k - 1], dt_s, par.process.slip_s, par.process.scaled, rolling)
            put(late, f.T @ late)
            put_rows(spread, f.T @ spread @ f)
