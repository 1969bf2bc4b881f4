"""Event loop of the filter: predict to each sample's stamp, compare, update, store.

`run` is the only kernel that a control cycle calls. It processes every event from the first new one on.
"""

import math

import numpy as np

from hil.core.geometry import Array
from hil.core.named_records import Records
from hil.estimator.kalman_update import Compared, condition, joint_nis, zero_negative_variances
from hil.estimator.kernel_layout import EventRow, Events, Memory, Parameters, States
from hil.estimator.matrix_loops import put, put_rows, seen
from hil.estimator.pose_correction import (
    correct_along_arc,
    find_linearisation_point,
    is_lost,
    is_unsure,
    transport_correction,
    transport_covariance,
)
from hil.estimator.process_model import advance_linear
from hil.estimator.sensors import (
    GATED_TOGETHER,
    MARK,
    NONLINEAR,
    account,
    admit,
    innovation,
    jacobian,
    new_frame,
    observe,
    predicted,
    reanchor,
    remember,
)
from hil.estimator.sensors.sensor import DUPLICATE, NEW_FRAME, USED
from hil.estimator.sensors.wheels import nominal
from hil.estimator.sigma_points import Points, advance_unscented, moments_unscented
from hil.estimator.state_vector import STATES
from hil.support.numba_jit import inner, kernel

NONE_ACCEPTED = -1.0
"""Gate value that no row passes."""


@inner
def advance(x: Array, p: Array, dt_s: float, par: Parameters, points: Points, nominal: Array) -> None:
    """Predict a state (20,) and its covariance (20, 20) by `dt_s` >= 0, in place; `nominal` (2,)."""
    if dt_s <= 0.0:
        return
    if points is None or is_lost(p, dt_s):
        advance_linear(x, p, dt_s, par.process, nominal)
    else:
        advance_unscented(x, p, dt_s, par, points, nominal)


@inner
def moments(number: int, x: Array, p: Array, par: Parameters, points: Points, count: int) -> None:
    """Compute the predicted rows and their covariances; sigma points only for nonlinear sensors.

    Args:
        number: sensor number.
        x: (20,) state.
        p: (20, 20) covariance.
        par: parameters of all kernels. `observe` has filled `par.work.aux`; this function fills `mean`,
            `cross` and `own` of `par.work`.
        points: sigma points of the UKF; None for the EKF.
        count: number of rows.
    """
    if points is not None and NONLINEAR[number] and not is_lost(p, 0.0):
        moments_unscented(number, x, p, par, points, count)
        return
    w = par.work
    predicted(number, x, w.aux[:], par, w.mean[:])
    h = w.h[:]
    h[:, :] = 0.0
    jacobian(number, x, w.aux[:], par, h)
    seen(p, h, count, w.cross[:], w.own[:])


@inner
def compare(
    number: int, t_ns: float, x: Array, p: Array, m: Memory, row: EventRow, par: Parameters, points: Points
) -> None:
    """Update the state with one sample; the state has already been predicted to the sample's stamp.

    Args:
        number: sensor number.
        t_ns: stamp, ns since the start.
        x: (20,) state; changed in place, as `p` and `m`.
        p: (20, 20) its covariance.
        m: memory.
        row: the sample.
        par: parameters of all kernels.
        points: sigma points of the UKF; None for the EKF.
    """
    w = par.work
    z, var, aux, nu, nis, before = w.z[:], w.var[:], w.aux[:], w.nu[:], w.nis[:], w.before[:]
    mean, shown, rows = w.mean[:], w.shown[:], Compared(nu, w.cross[:], w.own[:], var, nis)
    z[:], var[:], aux[:] = 0.0, 0.0, 0.0
    count = observe(number, t_ns, m, row, par, z, var, aux)
    if count == 0:
        return
    nis[:] = -1.0
    put(before, x)
    linear = points is None or is_lost(p, 0.0)
    unsure = linear and is_unsure(number, p)
    if unsure:
        spread = np.zeros((STATES, STATES))
        find_linearisation_point(number, before, p, count, par, x, spread)
    else:
        mean[:] = 0.0
        moments(number, x, p, par, points, count)
        innovation(number, z, mean, var, count, nu)
    put(shown, nu)
    gate = par.filter.gate_row
    if GATED_TOGETHER[number]:
        gate = math.inf
        if joint_nis(rows, count) > par.filter.gate_pose:
            gate = NONE_ACCEPTED
    if gate <= 0.0:
        put(x, before)
    elif unsure:
        point, toward = x.copy(), np.zeros(STATES)
        put_rows(p, spread)
        condition(toward, p, rows, count, gate)
        transport_correction(before, point, toward, -1.0)
        put(x, before + toward)
        correct_along_arc(before, x)
        transport_covariance(point, x, p)
    else:
        condition(x, p, rows, count, gate)
        if linear:
            correct_along_arc(before, x)
            transport_covariance(before, x, p)
    m.accepted += account(number, m, shown, nis, var, count, gate, par.filter.samples)


@kernel
def run(
    events: Events,
    states: States,
    start: int,
    zero_ns: int,
    pars: Records,
    points: Points,
    now_ns: int,
    now: States,
) -> None:
    """Process the events of a ring from `start` on, then predict the newest state to `now_ns`.

    Args:
        events: ring of events.
        states: states after each event, at the same ring slots; filled from `start` on.
        start: first event to process, at least 1.
        zero_ns: stamp that the stamps in sensor memory are relative to.
        pars: (1,) parameters of all kernels.
        points: sigma points of the UKF; None for the EKF, which is compiled separately.
        now_ns: time to predict to, where it is later than the newest event.
        now: arrays to fill with the newest state; its memory is an array (1,).
    """
    (marks, t_ns, numbers, rows), (x, p, m), (now_x, now_p, now_m) = events, states, now
    first, count, capacity, par = marks[0], marks[1], t_ns.shape[0], pars[0]
    rolling = par.work.rolling[:]
    for k in range(start, count):
        i, j = (first + k) % capacity, (first + k - 1) % capacity
        put(x[i], x[j])
        put_rows(p[i], p[j])
        m[i] = m[j]
        number, stamp = numbers[i], float(t_ns[i] - zero_ns)
        nominal(stamp, x[i], m[i].wheels, par.wheels, rolling)
        advance(x[i], p[i], (t_ns[i] - t_ns[j]) * 1e-9, par, points, rolling)
        if number == MARK:
            continue
        use = admit(number, stamp, m[i], rows[i], par)
        if use == DUPLICATE:
            m[i].duplicates += 1.0
        if use == USED:
            compare(number, stamp, x[i], p[i], m[i], rows[i], par, points)
            if reanchor(number, par.filter.limit, stamp, p[i], m[i], par):
                use = NEW_FRAME
        if use == NEW_FRAME:
            new_frame(number, stamp, x[i], p[i], m[i], rows[i], par)
        if use in (USED, NEW_FRAME):
            remember(number, stamp, x[i], p[i], m[i], rows[i], par)
            m[i].guarded += zero_negative_variances(p[i])
    last = (first + count - 1) % capacity
    put(now_x, x[last])
    put_rows(now_p, p[last])
    now_m[0] = m[last]
    ahead_ns = now_ns - t_ns[last]
    if ahead_ns > 0:
        nominal(float(now_ns - zero_ns), now_x, m[last].wheels, par.wheels, rolling)
        advance(now_x, now_p, ahead_ns / 1e9, par, points, rolling)
