"""Wheels: displacement of the body since the last servo read, from the cloned to the present pose.

Compared as eight scalar equations u_i = (P d)_i, each with its own gate, or as one body displacement. With d
= (d_x, d_y, turn) in the frame half-way, the wheels roll d_xy - R' (s dt + c rho) and turn by turn - kappa
rho; scale times D is added where the wheel scale is free. s, c and kappa are the slip states. rho is the mean
displacement of the wheels and D that of the body measured by the wheels, both at the mean speed of the last
half second. The step's own displacement, measured or estimated, is not used: its errors would correlate with
the row and be mistaken for slip or scale. The known slip per rolled metre, by direction of travel, is added
to the measured rows before the comparison; c and kappa are the remainder.

`aux` is (dt_s, rho_m, D: m, m, rad).
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Eight, Four, Record
from hil.core.signals import WheelMeasurement
from hil.estimator.constant_twist import sinc, sinc_slope
from hil.estimator.matrix_loops import check_size, put
from hil.estimator.sensors.sensor import DUPLICATE, FARTHEST_RAD, USED, Tally, is_repeated, no_frame, tally
from hil.estimator.state_vector import (
    CLONE_THETA,
    CLONE_X,
    CLONE_Y,
    CREEP_X,
    CREEP_Y,
    OMEGA,
    ROWS,
    SCALE,
    SLIP_X,
    SLIP_Y,
    STATES,
    THETA,
    V_X,
    V_Y,
    YAW_SLIP,
    X,
    Y,
)
from hil.estimator.wheel_friction import Contacts, contact_values, weighted_twist, windowed_twist
from hil.robot.kinematics import WheelGeometry, forward_matrix, projection
from hil.support.numba_jit import inner

NAME = "wheels"
NONLINEAR = True
ANGLE_ROW = -1
GATED_TOGETHER = False
START = {"t_ns": -1.0, "tally.nis_mean": 1.0}
FIGURES = {
    "nis_wheels": "tally.nis",
    "nis_mean_wheels": "tally.nis_mean",
    "innovation_wheels_m": "innovation_m",
    "rejected_wheels": "tally.rejected",
    "reanchored_wheels": "tally.reanchored",
    "rejected_wheel_fl": "refused.0",
    "rejected_wheel_bl": "refused.1",
    "rejected_wheel_br": "refused.2",
    "rejected_wheel_fr": "refused.3",
}

ROLLING_S = 0.5
SLOWEST_M_S = 1e-5
BODY_ROWS = 3
_FOUR = (4,)


new_frame = no_frame


class Parameters(Record):
    """Parameters of the wheels' kernels.

    Attributes:
        step, per_m, per_s, steering: variances of a displacement: m^2, m^2/m, m^2/s, m^2/rad^2.
        longest_gap_s: longest interval that counts as one displacement.
        from_rate: flag: 1 where the displacement comes from the rate, 0 from the angle.
        rows: number of rows: 8 equations, or 3 of one body displacement.
        friction_window_s: time constant of `hil.estimator.wheel_friction`; 0: least squares.
        creeping: flag: 1 for creep, 0 for dry friction.
        scaled: flag: 1 where the scale state belongs to the wheels, else 0.
        known: slip per rolled metre when driving up, down, left and right: wall x, wall y (m/m), turn
            (rad/m).
        contacts: the wheels on the surface.
        of_body: (8, 3) matrix from body displacement to rows.
        of_wheels: (8, 8) matrix from wheel displacements to rows.
    """

    step: float
    per_m: float
    per_s: float
    steering: float
    longest_gap_s: float
    from_rate: float
    rows: float
    friction_window_s: float
    creeping: float
    scaled: float
    known: Annotated[Array, 4, 3]
    contacts: Contacts
    of_body: Annotated[Array, 8, 3]
    of_wheels: Annotated[Array, 8, 8]


class Memory(Record):
    """The last servo read, and running means of the motion.

    Attributes:
        t_ns: stamp of the last read; negative before the first.
        angle_rad, steering_rad: angles of the last read; NaN where a wheel was not usable.
        speed_m_s: mean speed of the wheels over the last half second.
        ahead_m_s, left_m_s: velocity of the body between the last two reads, measured by the wheels alone.
        mean: velocity of the body (m/s, m/s, rad/s) measured by the wheels over the last half second.
        heading_rad: estimated heading at the last read.
        window_m: decaying sum of the last displacements, for friction.
        innovation_m: length of the innovation of the first two rows.
        refused: number of rejected equations of each wheel.
        contrary: 1 where half of the equations of the last read, or more, were rejected, else 0.
        tally: tally of all rows.
    """

    t_ns: float
    angle_rad: Four
    steering_rad: Four
    speed_m_s: float
    ahead_m_s: float
    left_m_s: float
    mean: Annotated[Array, 3]
    heading_rad: float
    window_m: Eight
    innovation_m: float
    refused: Four
    contrary: float
    tally: Tally


class Row(Record):
    """One servo read; `valid` is 1 or 0."""

    angle_rad: Four
    steering_rad: Four
    rate_rad_s: Four
    valid: Four


def values(config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> dict[str, Any]:
    """Values of `Parameters`."""
    w, slip = config.wheels, config.slip(surface)
    of_body, of_wheels = np.zeros((ROWS, BODY_ROWS)), np.zeros((ROWS, ROWS))
    if w.model == "equations":
        of_body[:], of_wheels[:] = projection(geometry.x_m, geometry.y_m), np.eye(ROWS)
    else:
        model = "paper" if w.model == "paper" else "exact"
        of_body[:BODY_ROWS] = np.eye(BODY_ROWS)
        of_wheels[:BODY_ROWS] = forward_matrix(geometry.x_m, geometry.y_m, model)
    return {
        "step": w.step_m**2,
        "per_m": w.per_sqrt_m**2,
        "per_s": w.per_sqrt_s**2,
        "steering": w.steering_m_rad**2,
        "longest_gap_s": w.longest_gap_s,
        "from_rate": w.source == "velocity",
        "rows": ROWS if w.model == "equations" else BODY_ROWS,
        "friction_window_s": w.friction_window_s if w.model in ("dry-friction", "creep") else 0.0,
        "creeping": w.model == "creep",
        "scaled": config.wheel_scale_sigma > 0,
        "known": np.array([slip.known_up, slip.known_down, slip.known_left, slip.known_right]),
        "contacts": contact_values(geometry),
        "of_body": of_body,
        "of_wheels": of_wheels,
    }


def is_used(config: EstimatorConfig) -> bool:
    """Always True."""
    return True


def pack(sample: WheelMeasurement) -> Sequence[float] | str:
    """Event row (16,) or the reason of refusal; a wheel with implausible angles is only marked invalid."""
    turned, steered = np.asarray(sample.wheel_angle_rad), np.asarray(sample.steering_rad)
    rates, valid = np.asarray(sample.wheel_rate_rad_s), list(sample.valid)
    if not turned.shape == steered.shape == rates.shape == _FOUR or len(valid) != 4:
        return "shape"
    angles = turned.tolist() + steered.tolist()
    if not sum(map(abs, angles)) < FARTHEST_RAD:
        for i in range(4):
            if not (abs(angles[i]) < FARTHEST_RAD and abs(angles[4 + i]) < FARTHEST_RAD):
                valid[i] = False
    return angles + rates.tolist() + valid if any(valid) else "not_finite"


@inner
def clone_pose(x: Array, p: Array) -> None:
    """Copy the pose and its covariances to the clone, in place."""
    check_size(p)
    for i in range(3):
        x[CLONE_X + i] = x[X + i]
        for j in range(STATES):
            p[CLONE_X + i, j] = p[X + i, j]
    for j in range(STATES):
        for i in range(3):
            p[j, CLONE_X + i] = p[j, X + i]


@inner
def admit(t_ns: float, m: Memory, row: Row, par: Parameters) -> int:
    """Accept every read whose stamp is new."""
    return DUPLICATE if is_repeated(t_ns, m.t_ns) else USED


@inner
def body_rows(
    u: Array, noise: Array, count: int, dt_s: float, m: Memory, par: Parameters, z: Array, var: Array
) -> int:
    """Fill one body displacement of all four wheels; return the number of rows, 0 if a wheel is missing.

    Args:
        u: (8,) displacement of each wheel, m, body frame.
        noise: (8,) variances of `u`.
        count: number of usable wheels.
        dt_s: duration of the step.
        m: memory.
        par: parameters.
        z: (8,) filled.
        var: (8,) filled.
    """
    if count < 4:
        return 0
    friction, f = par.friction_window_s > 0.0, par.of_wheels
    if friction:
        decay = math.exp(-dt_s / par.friction_window_s)
        window = np.zeros(ROWS)
        put(window, m.window_m)
        b = windowed_twist(u, window, decay, par.contacts, par.creeping > 0.0)
        put(m.window_m, window)
        for j in range(BODY_ROWS):
            z[j] = b[j]
    for j in range(BODY_ROWS):
        total, spread = 0.0, 0.0
        for i in range(ROWS):
            total += f[j, i] * u[i]
            spread += f[j, i] * f[j, i] * noise[i]
        if not friction:
            z[j] = total
        var[j] = spread
    return BODY_ROWS


@inner
def known_slip(m: Memory, par: Parameters, dt_s: float) -> Array:
    """Slip (3,) of a step of `dt_s` expected from the known slip per metre: m, m, rad, body frame.

    The weight pulls along wall x for every direction of travel; the wheels yield by their stiffness
    lengthwise and sideways. So between two axes the slip is weighted with the squared direction cosines, plus
    the mixed term that such a tensor has.
    """
    c, s = math.cos(m.heading_rad), math.sin(m.heading_rad)
    up, left = c * m.mean[0] - s * m.mean[1], s * m.mean[0] + c * m.mean[1]
    speed = math.hypot(up, left)
    out = np.zeros(BODY_ROWS)
    if speed < SLOWEST_M_S:
        return out
    up, left = up / speed, left / speed
    k, along, across = par.known, 0 if up > 0.0 else 1, 2 if left > 0.0 else 3
    for j in range(BODY_ROWS):
        out[j] = up * up * k[along, j] + left * left * k[across, j]
    x, y, turn = out[0], out[1], out[2]
    y += 0.5 * up * left * (k[0, 0] + k[1, 0] - k[2, 0] - k[3, 0])
    rolled_m = speed * dt_s
    out[0], out[1], out[2] = (c * x + s * y) * rolled_m, (c * y - s * x) * rolled_m, turn * rolled_m
    return out


@inner
def observe(t_ns: float, m: Memory, row: Row, par: Parameters, z: Array, var: Array, aux: Array) -> int:
    """Wheel displacements since the last read as eight or three rows; 0 rows after a gap."""
    dt = (t_ns - m.t_ns) * 1e-9
    if m.t_ns < 0.0 or dt > par.longest_gap_s:
        return 0
    u, noise, known = np.zeros(ROWS), np.full(ROWS, -1.0), np.zeros(4)
    rolled, count, steering, last, wheels = 0.0, 0, row.steering_rad, m.steering_rad, par.contacts
    for i in range(4):
        angle = row.rate_rad_s[i] * dt if par.from_rate > 0.0 else row.angle_rad[i] - m.angle_rad[i]
        turned = steering[i] - last[i]
        if not (math.isfinite(angle) and math.isfinite(turned)):
            continue
        whole = 2.0 * math.pi * math.floor(turned / (2.0 * math.pi) + 0.5)
        turned -= whole
        length = angle * wheels.radius_m[i]
        heading = 0.5 * (steering[i] - whole + last[i]) - wheels.steering_zero_rad[i]
        u[2 * i], u[2 * i + 1] = length * math.cos(heading), length * math.sin(heading)
        spread = par.step + par.per_m * abs(length) + par.per_s * dt
        noise[2 * i] = noise[2 * i + 1] = spread + par.steering * turned * turned
        rolled += abs(length)
        known[i] = 1.0
        count += 1
    if count == 0:
        return 0
    weight = 1.0 - math.exp(-dt / ROLLING_S)
    m.speed_m_s += weight * (rolled / (count * dt) - m.speed_m_s)
    aux[0], aux[1] = dt, m.speed_m_s * dt
    if count > 1:
        body = weighted_twist(u, known, wheels)
        m.ahead_m_s, m.left_m_s = body[0] / dt, body[1] / dt
        for i in range(BODY_ROWS):
            m.mean[i] += weight * (body[i] / dt - m.mean[i])
    for i in range(BODY_ROWS):
        aux[2 + i] = m.mean[i] * dt
    if par.rows > BODY_ROWS:
        put(z, u)
        put(var, noise)
        rows = ROWS
    else:
        rows = body_rows(u, noise, count, dt, m, par, z, var)
    slipped, f = known_slip(m, par, dt), par.of_body
    for j in range(rows):
        z[j] += f[j, 0] * slipped[0] + f[j, 1] * slipped[1] + f[j, 2] * slipped[2]
    return rows


@inner
def nominal(t_ns: float, x: Array, m: Memory, par: Parameters, out: Array) -> None:
    """Fill `out` (2,) with the body's velocity, m/s: by the last wheel reads, or by the state after a gap."""
    if m.t_ns < 0.0 or (t_ns - m.t_ns) * 1e-9 > par.longest_gap_s:
        out[0], out[1] = x[V_X], x[V_Y]
    else:
        out[0], out[1] = m.ahead_m_s, m.left_m_s


@inner
def predicted(x: Array, aux: Array, par: Parameters, out: Array) -> None:
    """Predicted rows: displacement from the cloned to the present pose, less the slip."""
    dt, rho = aux[0], aux[1]
    mid, h = 0.5 * (x[THETA] + x[CLONE_THETA]), 0.5 * (x[THETA] - x[CLONE_THETA])
    g = 1.0 / sinc(h)
    c, s = math.cos(mid), math.sin(mid)
    qx = g * (x[X] - x[CLONE_X]) - x[SLIP_X] * dt - x[CREEP_X] * rho
    qy = g * (x[Y] - x[CLONE_Y]) - x[SLIP_Y] * dt - x[CREEP_Y] * rho
    scale = par.scaled * x[SCALE]
    dx, dy = c * qx + s * qy + scale * aux[2], c * qy - s * qx + scale * aux[3]
    turn = 2.0 * h - x[YAW_SLIP] * rho + scale * aux[4]
    f = par.of_body
    for j in range(int(par.rows)):
        out[j] = f[j, 0] * dx + f[j, 1] * dy + f[j, 2] * turn


@inner
def jacobian(x: Array, aux: Array, par: Parameters, h: Array) -> None:
    """Derivative of `predicted` by the state: of the body displacement (3, 20), then of the rows."""
    dt, rho = aux[0], aux[1]
    mid, half = 0.5 * (x[THETA] + x[CLONE_THETA]), 0.5 * (x[THETA] - x[CLONE_THETA])
    k = sinc(half)
    g, bend = 1.0 / k, -sinc_slope(half) / (k * k)
    c, s = math.cos(mid), math.sin(mid)
    px, py = x[X] - x[CLONE_X], x[Y] - x[CLONE_Y]
    qx = g * px - x[SLIP_X] * dt - x[CREEP_X] * rho
    qy = g * py - x[SLIP_Y] * dt - x[CREEP_Y] * rho
    ahead, left = c * qx + s * qy, c * qy - s * qx
    bend_x, bend_y = bend * (c * px + s * py), bend * (c * py - s * px)
    d = np.zeros((3, STATES))
    d[0, X], d[0, Y], d[1, X], d[1, Y] = g * c, g * s, -g * s, g * c
    d[0, THETA], d[0, CLONE_THETA] = 0.5 * (left + bend_x), 0.5 * (left - bend_x)
    d[1, THETA], d[1, CLONE_THETA] = 0.5 * (-ahead + bend_y), 0.5 * (-ahead - bend_y)
    d[2, THETA], d[2, CLONE_THETA], d[2, YAW_SLIP] = 1.0, -1.0, -rho
    for j in range(2):
        d[j, CLONE_X], d[j, CLONE_Y] = -d[j, X], -d[j, Y]
        for i in range(2):
            axis = d[j, X + i] / g
            d[j, SLIP_X + i], d[j, CREEP_X + i] = -axis * dt, -axis * rho
    for j in range(3):
        d[j, SCALE] = par.scaled * aux[2 + j]
    f = par.of_body
    for j in range(int(par.rows)):
        for i in range(STATES):
            h[j, i] = f[j, 0] * d[0, i] + f[j, 1] * d[1, i] + f[j, 2] * d[2, i]


@inner
def account(m: Memory, nu: Array, nis: Array, var: Array, count: int, gate: float, samples: float) -> int:
    """Count all rows in one tally; of eight equations also the rejected ones per wheel."""
    m.innovation_m = math.hypot(nu[0], nu[1])
    total, usable, used = 0.0, 0, 0
    for i in range(count):
        if var[i] < 0.0:
            continue
        usable += 1
        if nis[i] <= gate:
            used += 1
            total += nis[i]
        elif count > BODY_ROWS:
            m.refused[i // 2] += 1.0
    tally(m.tally, total, used, usable, samples)
    m.contrary = 1.0 if 2 * used <= usable else 0.0
    return used


@inner
def reanchor(limit: float, t_ns: float, p: Array, m: Memory, par: Parameters) -> bool:
    """Raise the variance of the twist after too many rejections in a row, or where half a read is rejected.

    The equations of a read are used one after the other: those of one wheel, taken first, must not hold an
    estimate that the others contradict, as where the robot accelerates harder than expected.
    """
    lost = m.tally.in_row >= limit
    if not lost and m.contrary == 0.0:
        return False
    m.tally.in_row = m.contrary = 0.0
    m.tally.reanchored += 1.0 if lost else 0.0
    p[V_X, V_X] += 0.01
    p[V_Y, V_Y] += 0.01
    p[OMEGA, OMEGA] += 0.1
    return False


@inner
def remember(t_ns: float, x: Array, p: Array, m: Memory, row: Row, par: Parameters) -> None:
    """Store the read, and clone the pose at which it was made."""
    m.t_ns = t_ns
    for i in range(4):
        valid = row.valid[i] > 0.0
        m.angle_rad[i] = row.angle_rad[i] if valid else math.nan
        m.steering_rad[i] = row.steering_rad[i] if valid else math.nan
    m.heading_rad = x[THETA]
    clone_pose(x, p)


@inner
def undo(t_ns: float, x: Array, m: Memory, row: Row, par: Parameters, late: Array, spread: Array) -> None:
    """Carry back through the cloning of the pose."""
    for i in range(3):
        late[X + i] += late[CLONE_X + i]
        late[CLONE_X + i] = 0.0
        for k in range(STATES):
            spread[X + i, k] += spread[CLONE_X + i, k]
            spread[CLONE_X + i, k] = 0.0
    for i in range(3):
        for k in range(STATES):
            spread[k, X + i] += spread[k, CLONE_X + i]
            spread[k, CLONE_X + i] = 0.0
