"""Odometry: integrating body motion to a pose, and the paper's state-space model with derivatives.

The paper's model has 11 states (x, y, theta, phi_1..4, delta_1..4) and 8 inputs (v_1..4, steering rates
1..4), arXiv 2509.04016. The bench does not use it; it serves to compare your own estimator or controller with
the paper. SI units; poses in the frame of the start pose.
"""

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import Array, ArrayLike, wrap_array
from hil.robot.kinematics import WheelGeometry, forward_matrix, wheel_vectors

INTEGRATORS = ("exponential", "euler")


def integrate(start_pose: ArrayLike, motion_body: Array, integrator: str = "exponential") -> Array:
    """Integrate body displacements (..., n, 3) to poses (..., n + 1, 3), the start included.

    Args:
        start_pose: (..., 3) m, m, rad.
        motion_body: (..., n, 3) twist times step time, in the frame of the step's start.
        integrator: `exponential` is exact for a constant twist within the step, `euler` is the
            paper's forward Euler.

    Raises:
        UsageError: another integrator.
    """
    start = np.asarray(start_pose, dtype=np.float64)
    dx, dy, turn = motion_body[..., 0], motion_body[..., 1], motion_body[..., 2]
    out = np.empty((*motion_body.shape[:-2], motion_body.shape[-2] + 1, 3))
    out[..., 0, :] = start
    out[..., 1:, 2] = start[..., 2:3] + np.cumsum(turn, axis=-1)
    if integrator == "exponential":
        c, s = chord(out[..., :-1, 2], turn)
    elif integrator == "euler":
        c, s = np.cos(out[..., :-1, 2]), np.sin(out[..., :-1, 2])
    else:
        raise UsageError(f"integrator {integrator!r}", expected="one of " + ", ".join(INTEGRATORS))
    out[..., 1:, 0] = start[..., 0:1] + np.cumsum(c * dx - s * dy, axis=-1)
    out[..., 1:, 1] = start[..., 1:2] + np.cumsum(s * dx + c * dy, axis=-1)
    return out


def displacements(poses: Array) -> Array:
    """Body displacements (n, 3) of constant twist from each of the poses (n + 1, 3) to the next."""
    way = np.diff(poses, axis=0)
    turn = wrap_array(way[:, 2])
    c, s = chord(poses[:-1, 2], turn)
    long = c**2 + s**2
    ahead, left = (c * way[:, 0] + s * way[:, 1]) / long, (c * way[:, 1] - s * way[:, 0]) / long
    return np.column_stack([ahead, left, turn])


def sample_path(at_s: Array, edges_s: Array, poses: Array, motion: Array) -> Array:
    """Poses (n, 3) at arbitrary instants on a path with constant body twist between its edges.

    Args:
        at_s: (n,) instants, s.
        edges_s: (b + 1,) edges of the blocks, s.
        poses: poses (b or more, 3) at the edges, wall frame.
        motion: (b, 3) body displacement in each block.
    """
    k = np.clip(np.searchsorted(edges_s, at_s, side="right") - 1, 0, len(motion) - 1)
    share = ((at_s - edges_s[k]) / (edges_s[k + 1] - edges_s[k]))[:, None]
    part = motion[k] * share
    half = 0.5 * part[:, 2]
    chord, heading = np.sinc(half / np.pi), poses[k, 2] + half
    c, s = np.cos(heading) * chord, np.sin(heading) * chord
    x = poses[k, 0] + c * part[:, 0] - s * part[:, 1]
    y = poses[k, 1] + s * part[:, 0] + c * part[:, 1]
    return np.column_stack([x, y, poses[k, 2] + part[:, 2]])


def chord(heading: Array, turn: Array) -> tuple[Array, Array]:
    """Cosine and sine of the direction of a step's chord, times chord over arc length; numbers or (n,).

    Args:
        heading: heading at the start of the step, rad.
        turn: turn within the step, rad.
    """
    half = 0.5 * turn
    length = np.sinc(half / np.pi)
    return np.cos(heading + half) * length, np.sin(heading + half) * length


def chord_slopes(heading: Array, step: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Derivatives of a step's displacement (x, y) by its turn, at a fixed heading after the step.

    If the heading after the step changes by t and the turn by d, the displacement changes by these
    derivatives times d, plus the displacement rotated by a quarter turn to the left times t.

    Args:
        heading: heading at the start of the step, rad.
        step: body displacement in the frame of the step's start, m, m, rad.
    """
    dx, dy, half = step[0], step[1], 0.5 * step[2]
    small = 1.0 * (np.abs(half) < 1e-4)
    safe = half + small
    bend = small * (-half / 3.0) + (1.0 - small) * (np.cos(safe) - np.sin(safe) / safe) / safe
    length, c, s = np.sinc(half / np.pi), np.cos(heading + half), np.sin(heading + half)
    ahead, left = c * dx - s * dy, s * dx + c * dy
    return 0.5 * (length * left + bend * ahead), 0.5 * (bend * left - length * ahead)


def integrate_with_jacobian(
    start_pose: ArrayLike, motion_body: Array, motion_jacobian: Array
) -> tuple[Array, Array]:
    """Poses (..., n + 1, 3) by SE(2) exponential, and derivatives (3, m, ..., n) by m parameters.

    The start has no derivative and is left out of the derivatives.

    Args:
        start_pose: start pose (..., 3), taken as independent of the parameters.
        motion_body: (..., n, 3) displacement per step.
        motion_jacobian: (3, m, ..., n) derivatives of `motion_body`.
    """
    poses = integrate(start_pose, motion_body)
    heading, (dx, dy, turn) = poses[..., :-1, 2], np.moveaxis(motion_body, -1, 0)
    c, s = chord(heading, turn)
    by_x, by_y = chord_slopes(heading, (dx, dy, turn))
    jx, jy, jt = motion_jacobian
    out = np.empty(motion_jacobian.shape)
    theta = np.cumsum(jt, axis=-1, out=out[2])
    np.cumsum(c * jx - s * jy - (s * dx + c * dy) * theta + by_x * jt, axis=-1, out=out[0])
    np.cumsum(s * jx + c * jy + (c * dx - s * dy) * theta + by_y * jt, axis=-1, out=out[1])
    return poses, out


def state_derivative(
    geometry: WheelGeometry, state: ArrayLike, inputs: ArrayLike, model: str = "exact"
) -> Array:
    """Time derivative (11,) of the paper's state (11,) under inputs (8,).

    State (x, y, theta, phi_1..4, delta_1..4); inputs (v_1..4 m/s, steering rates 1..4 rad/s).

    Args:
        geometry: wheel parameters.
        state: (11,) pose in the wall frame (m, rad), wheel angles and steering angles (rad).
        inputs: (8,) rolling speeds (m/s) and steering rates (rad/s).
        model: `exact` or `paper`.
    """
    s, w = np.asarray(state, dtype=np.float64), np.asarray(inputs, dtype=np.float64)
    u = wheel_vectors(w[:4], s[7:11] - geometry.steering_zero_rad)
    v_x, v_y, omega = forward_matrix(geometry.x_m, geometry.y_m, model) @ u
    c, sn = np.cos(s[2]), np.sin(s[2])
    return np.concatenate([[c * v_x - sn * v_y, sn * v_x + c * v_y, omega], w[:4] / geometry.radius_m, w[4:]])


def state_jacobian(
    geometry: WheelGeometry, state: ArrayLike, inputs: ArrayLike, model: str = "exact"
) -> Array:
    """Derivative (11, 11) of `state_derivative` by the state.

    Args:
        geometry: wheel parameters.
        state: state (11,), as for `state_derivative`.
        inputs: inputs (8,), likewise.
        model: `exact` or `paper`.
    """
    s, w = np.asarray(state, dtype=np.float64), np.asarray(inputs, dtype=np.float64)
    f = forward_matrix(geometry.x_m, geometry.y_m, model)
    heading = s[7:11] - geometry.steering_zero_rad
    v_x, v_y, _ = f @ wheel_vectors(w[:4], heading)
    c, sn = np.cos(s[2]), np.sin(s[2])
    out = np.zeros((11, 11))
    out[0, 2], out[1, 2] = -sn * v_x - c * v_y, c * v_x - sn * v_y
    for i in range(4):
        du = w[i] * np.array([-np.sin(heading[i]), np.cos(heading[i])])
        a, b, k = f[:, 2 * i : 2 * i + 2] @ du
        out[0, 7 + i], out[1, 7 + i], out[2, 7 + i] = c * a - sn * b, sn * a + c * b, k
    return out


def input_jacobian(geometry: WheelGeometry, state: ArrayLike, model: str = "exact") -> Array:
    """Derivative (11, 8) of `state_derivative` by the inputs; it does not depend on the inputs.

    Args:
        geometry: wheel parameters.
        state: state (11,), as for `state_derivative`.
        model: `exact` or `paper`.
    """
    s = np.asarray(state, dtype=np.float64)
    f = forward_matrix(geometry.x_m, geometry.y_m, model)
    heading = s[7:11] - geometry.steering_zero_rad
    c, sn = np.cos(s[2]), np.sin(s[2])
    out = np.zeros((11, 8))
    for i in range(4):
        a, b, k = f[:, 2 * i : 2 * i + 2] @ np.array([np.cos(heading[i]), np.sin(heading[i])])
        out[0, i], out[1, i], out[2, i] = c * a - sn * b, sn * a + c * b, k
        out[3 + i, i] = 1.0 / geometry.radius_m[i]
        out[7 + i, 4 + i] = 1.0
    return out
