"""One event after the other through the filter: predict, compare, condition, remember.

`run` is the only kernel that a control cycle calls: it replays every event from the first new one on.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hil.estimator import layout as L
from hil.estimator.compiled import compiled
from hil.estimator.conditioning import condition, guard, joint_nis
from hil.estimator.process import advance_linear, anchor_frame, copy_pose
from hil.estimator.sensors import jacobian, observe, predicted
from hil.estimator.small_matrices import seen
from hil.estimator.unscented import advance_unscented, moments_unscented
from hil.vocabulary.geometry import Array

Ints = npt.NDArray[np.int64]


@compiled
def advance(x: Array, p: Array, dt_s: float, par: Array) -> None:
    """Prediction by `dt_s` >= 0, in place."""
    if dt_s <= 0.0:
        return
    if par[L.UNSCENTED] > 0.0:
        advance_unscented(x, p, dt_s, par)
    else:
        advance_linear(x, p, dt_s, par)


@compiled
def moments(
    kind: int, x: Array, p: Array, aux: Array, par: Array, rows: Array, count: int,
    mean: Array, cross: Array, own: Array,
) -> None:  # fmt: skip
    """Mean, cross covariance and covariance of the predicted rows; linear rows need no sigma points."""
    if par[L.UNSCENTED] > 0.0 and (kind == L.WHEELS or kind == L.TRACKER):
        moments_unscented(kind, x, p, aux, par, rows, count, mean, cross, own)
        return
    predicted(kind, x, aux, par, rows, mean)
    h = np.zeros((L.ROWS, L.STATES))
    jacobian(kind, x, aux, par, rows, h)
    seen(p, h, count, cross, own)


@compiled
def admit(kind: int, t_ns: float, m: Array, data: Array, par: Array) -> int:
    """Whether a sample may be used: 0 no, 1 yes, 2 it starts a new frame of the camera, 3 duplicate stamp.

    Duplicates of a sensor's stamp say nothing new; a camera pose of too little quality is dropped; a step
    that the robot cannot have made starts a new frame.
    """
    last = L.WHEEL_T
    if kind == L.GYRO:
        last = L.GYRO_T
    elif kind == L.TRACKER:
        last = L.TRACKER_T
    elif kind == L.MOCAP:
        last = L.MOCAP_T
    if m[last] >= 0.0 and t_ns - m[last] < 1000.0:
        return 3
    if kind == L.MOCAP:
        return 1 if par[L.MOCAP_ON] > 0.0 and data[4] > 0.0 else 0
    if kind != L.TRACKER:
        return 1
    if par[L.TRACKER_ON] <= 0.0 or data[4] <= 0.0 or data[3] < par[L.QUALITY]:
        return 0
    if m[L.FRAME_T] < 0.0:
        return 2
    dt = (t_ns - m[L.TRACKER_T]) * 1e-9
    far = math.hypot(data[0] - m[L.TRACKER_POSE], data[1] - m[L.TRACKER_POSE + 1])
    turn = abs(data[2] - m[L.TRACKER_POSE + 2])
    if far > par[L.JUMP_M] + par[L.FAST_M_S] * dt or turn > par[L.JUMP_RAD] + par[L.FAST_RAD_S] * dt:
        return 2
    return 1


@compiled
def anchor(t_ns: float, x: Array, p: Array, m: Array, data: Array, par: Array) -> None:
    """Give the camera a new frame at this sample; the first one is not counted as re-anchoring."""
    if m[L.FRAME_T] >= 0.0:
        m[L.REANCHORED + L.TRACKER] += 1.0
    anchor_frame(x, p, data[:3], par[L.TRACKER_M], par[L.TRACKER_RAD], par[L.CAMERA_SCALED])
    m[L.FRAME_T] = t_ns
    m[L.IN_ROW + L.TRACKER] = 0.0


@compiled
def tally(slot: int, m: Array, nis: float, used: int, rows: int, par: Array) -> None:
    """Count accepted and rejected rows of a sensor and keep its normalised innovation."""
    m[L.ACCEPTED + slot] += used
    m[L.REJECTED + slot] += rows - used
    if rows == 0:
        return
    m[L.NIS + slot] = nis
    m[L.NIS_MEAN + slot] += (nis / rows - m[L.NIS_MEAN + slot]) / par[L.NIS_N]
    if used > 0:
        m[L.IN_ROW + slot] = 0.0
    else:
        m[L.IN_ROW + slot] += 1.0


@compiled
def let_in(kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array, par: Array) -> None:
    """Re-anchor a sensor that was rejected too often in a row: no sensor is locked out for ever."""
    if kind == L.GYRO and m[L.IN_ROW + L.GRAVITY] >= par[L.REANCHOR]:
        m[L.IN_ROW + L.GRAVITY] = 0.0
        m[L.REANCHORED + L.GRAVITY] += 1.0
        p[2, 2] += 0.0025
        p[13, 13] += 0.0025
    if m[L.IN_ROW + kind] < par[L.REANCHOR]:
        return
    if kind == L.TRACKER:
        anchor(t_ns, x, p, m, data, par)
        return
    m[L.IN_ROW + kind] = 0.0
    m[L.REANCHORED + kind] += 1.0
    if kind == L.WHEELS:
        p[3, 3] += 0.01
        p[4, 4] += 0.01
        p[5, 5] += 0.1
    elif kind == L.GYRO:
        p[5, 5] += 0.01
        p[6, 6] += 0.01
    else:
        p[0, 0] += 1.0
        p[1, 1] += 1.0
        p[2, 2] += 1.0


@compiled
def account(kind: int, m: Array, nis: Array, var: Array, count: int, gate: float, par: Array) -> None:
    """Counters and figures of one sample after its rows were conditioned on."""
    if kind == L.GYRO:
        for i in range(2):
            slot = L.GYRO if i == 0 else L.GRAVITY
            if var[i] > 0.0:
                tally(slot, m, nis[i], 1 if 0.0 <= nis[i] <= gate else 0, 1, par)
        return
    total, usable, used = 0.0, 0, 0
    for i in range(count):
        if var[i] < 0.0:
            continue
        usable += 1
        if nis[i] <= gate:
            used += 1
            total += nis[i]
        elif kind == L.WHEELS and par[L.WHEEL_ROWS] > 3.0:
            m[L.WHEEL_REJECTED + i // 2] += 1.0
    tally(kind, m, total, used, usable, par)


@compiled
def innovations(kind: int, z: Array, mean: Array, var: Array, count: int) -> Array:
    """Measured minus predicted rows (8,), headings wrapped; a row that is not finite is marked in `var`."""
    nu = z - mean
    for i in range(count):
        if not math.isfinite(nu[i]):
            nu[i], var[i] = 0.0, -1.0
    angle = 1 if kind == L.GYRO else 2
    if kind != L.WHEELS:
        nu[angle] = math.pi - (math.pi - nu[angle]) % (2.0 * math.pi)
    return nu


@compiled
def show_innovation(kind: int, nu: Array, m: Array) -> None:
    """Keep one figure of the innovation for the diagnostics: a distance, or the gyro's rate."""
    m[L.INNOVATION + kind - 1] = math.hypot(nu[0], nu[1]) if kind != L.GYRO else nu[0]


@compiled
def compare(
    kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array, par: Array, wheels: Array, rows: Array
) -> None:
    """Update with one sample at its own time; the state is already there."""
    z, var, aux = np.zeros(L.ROWS), np.zeros(L.ROWS), np.zeros(2)
    count = observe(kind, t_ns, m, data, par, wheels, rows, z, var, aux)
    if count == 0:
        return
    mean, nis = np.zeros(L.ROWS), np.full(L.ROWS, -1.0)
    cross, own = np.zeros((L.STATES, L.ROWS)), np.zeros((L.ROWS, L.ROWS))
    moments(kind, x, p, aux, par, rows, count, mean, cross, own)
    nu = innovations(kind, z, mean, var, count)
    show_innovation(kind, nu, m)
    gate = par[L.GATE1]
    if kind == L.TRACKER or kind == L.MOCAP:
        total = joint_nis(nu, own, var, count)
        if total > par[L.GATE3]:
            tally(kind, m, total, 0, count, par)
            return
        gate = math.inf
    condition(x, p, nu, cross, own, var, count, gate, nis)
    account(kind, m, nis, var, count, gate, par)


@compiled
def remember(kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array, par: Array) -> None:
    """Keep what the next sample of this sensor is compared with, and clone the pose at a servo read."""
    if kind == L.WHEELS:
        m[L.WHEEL_T] = t_ns
        for i in range(4):
            valid = data[12 + i] > 0.0
            m[L.WHEEL_ANGLE + i] = data[i] if valid else math.nan
            m[L.WHEEL_STEER + i] = data[4 + i] if valid else math.nan
        copy_pose(x, p, L.CLONE)
    elif kind == L.GYRO:
        m[L.GYRO_T] = t_ns
    elif kind == L.MOCAP:
        m[L.MOCAP_T] = t_ns
    else:
        m[L.TRACKER_T] = t_ns
        for i in range(3):
            m[L.TRACKER_POSE + i] = data[i]
        if par[L.BASELINE_S] > 0.0 and (t_ns - m[L.FRAME_T]) * 1e-9 >= par[L.BASELINE_S]:
            anchor_frame(x, p, data[:3], par[L.TRACKER_M], par[L.TRACKER_RAD], par[L.CAMERA_SCALED])
            m[L.FRAME_T] = t_ns


@compiled
def take(
    kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array, par: Array, wheels: Array, rows: Array
) -> None:
    """One sample, the state being predicted to its stamp."""
    if kind == L.RESET:
        return
    use = admit(kind, t_ns, m, data, par)
    if use == 0:
        m[L.REJECTED + kind] += 1.0
        return
    if use == 3:
        m[L.DUPLICATES] += 1.0
        return
    if use == 2:
        anchor(t_ns, x, p, m, data, par)
    else:
        compare(kind, t_ns, x, p, m, data, par, wheels, rows)
        let_in(kind, t_ns, x, p, m, data, par)
    remember(kind, t_ns, x, p, m, data, par)
    m[L.GUARDED] += guard(p)


@compiled
def run_to(
    marks: Ints, begin: int, zero_ns: int, t_ns: Ints, kinds: Ints, data: Array, x: Array, p: Array, m: Array,
    par: Array, wheels: Array, rows: Array, now_ns: int, now_x: Array, now_p: Array, now_m: Array,
) -> None:  # fmt: skip
    """`run` to the end of a history, and its newest state predicted to `now_ns` where that is later.

    `marks` (4,) begins with the first slot and the number of events; `now_x` (20,), `now_p` (20, 20) and
    `now_m` (72,) are filled. Everything else is as for `run`.
    """
    first, count = marks[0], marks[1]
    run(first, begin, count, zero_ns, t_ns, kinds, data, x, p, m, par, wheels, rows)
    last = (first + count - 1) % t_ns.shape[0]
    now_x[:] = x[last]
    now_p[:] = p[last]
    now_m[:] = m[last]
    ahead_ns = now_ns - t_ns[last]
    if ahead_ns > 0:
        advance(now_x, now_p, ahead_ns / 1e9, par)


@compiled
def run(
    first: int, begin: int, end: int, zero_ns: int, t_ns: Ints, kinds: Ints, data: Array,
    x: Array, p: Array, m: Array, par: Array, wheels: Array, rows: Array,
) -> None:  # fmt: skip
    """Replay events `begin` to `end` of the ring; checkpoint k is the state after event k.

    Args:
        first: ring slot of event 0; event k is in slot (first + k) % capacity.
        begin: first event to replay, at least 1.
        end: number of events.
        zero_ns: stamp that sensor memory counts from.
        t_ns: (capacity,) stamps.
        kinds: (capacity,) sensor ids.
        data: (capacity, 16) event rows.
        x: (capacity, 20) states.
        p: (capacity, 20, 20) covariances.
        m: (capacity, 72) sensor memories.
        par: `layout.parameters`.
        wheels: (6, 4), and
        rows: (8, 11), of `layout.wheel_tables`.
    """
    capacity = t_ns.shape[0]
    for k in range(begin, end):
        i, j = (first + k) % capacity, (first + k - 1) % capacity
        x[i] = x[j]
        p[i] = p[j]
        m[i] = m[j]
        advance(x[i], p[i], (t_ns[i] - t_ns[j]) * 1e-9, par)
        take(kinds[i], float(t_ns[i] - zero_ns), x[i], p[i], m[i], data[i], par, wheels, rows)
