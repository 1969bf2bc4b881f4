"""Body displacement of four wheels that contradict each other, for the filter kernels.

Within one servo step the disagreement of the wheels is smaller than the quantisation of the encoders. So the
weights are computed from the steps of the last `friction_window_s` together and applied to the newest step
(blocks of 0.3 s, continuation q = 2, 1.5, 1.2, 1). The laws are those of `hil.robot.contact_laws`.
"""

import math

import numpy as np

from hil.core.geometry import Array
from hil.core.named_records import Four, Record, Records, dtype_of, filled
from hil.robot.contact_laws import FRICTION_EPSILON, LEAST_ROLLED
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import inner

STILL_M = 2.5e-5
_POWERS = np.array([2.0, 1.5, 1.5, 1.5, 1.2, 1.2, 1.2, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])


class Contacts(Record):
    """Contact points of the wheels in the body frame, with loads and stiffness.

    Attributes:
        radius_m, steering_zero_rad, x_m, y_m: calibrated geometry of each wheel.
        load, across: normal load relative to the mean, which is also the relative creep stiffness lengthwise,
            and the relative creep stiffness sideways.
    """

    radius_m: Four
    steering_zero_rad: Four
    x_m: Four
    y_m: Four
    load: Four
    across: Four


def contact_values(geometry: WheelGeometry) -> dict[str, Array]:
    """Values of `Contacts`, (4,) each."""
    g = geometry
    return {
        "radius_m": g.radius_m,
        "steering_zero_rad": g.steering_zero_rad,
        "x_m": g.x_m,
        "y_m": g.y_m,
        "load": g.load,
        "across": g.creep_ratio * g.load,
    }


def contacts(geometry: WheelGeometry) -> Records:
    """`Contacts` (1,) of calibrated wheels."""
    return filled(dtype_of(Contacts), contact_values(geometry))


@inner
def weighted_twist(u: Array, weight: Array, wheels: Contacts) -> Array:
    """Body displacement (3,) (m, m, rad) that fits wheel vectors (8,) m with one weight (4,) per wheel."""
    total, sx, sy, srr = 0.0, 0.0, 0.0, 0.0
    bx, by, bt = 0.0, 0.0, 0.0
    for i in range(4):
        w, px, py = weight[i], wheels.x_m[i], wheels.y_m[i]
        total += w
        sx += w * px
        sy += w * py
        srr += w * (px * px + py * py)
        bx += w * u[2 * i]
        by += w * u[2 * i + 1]
        bt += w * (px * u[2 * i + 1] - py * u[2 * i])
    turn = (bt - (sx * by - sy * bx) / total) / (srr - (sx * sx + sy * sy) / total)
    return np.array([(bx + sy * turn) / total, (by - sx * turn) / total, turn])


@inner
def friction_weights(u: Array, wheels: Contacts) -> Array:
    """Weight (4,) of each contact at the least-dissipation displacement of wheel vectors (8,)."""
    weight = np.ones(4)
    scale = 1e-9
    for i in range(4):
        scale += 0.25 * math.sqrt(u[2 * i] * u[2 * i] + u[2 * i + 1] * u[2 * i + 1])
    for power in _POWERS:
        b = weighted_twist(u, weight, wheels)
        for i in range(4):
            ex = b[0] - wheels.y_m[i] * b[2] - u[2 * i]
            ey = b[1] + wheels.x_m[i] * b[2] - u[2 * i + 1]
            size = math.sqrt(ex * ex + ey * ey) / scale + FRICTION_EPSILON
            weight[i] = wheels.load[i] * math.exp((power - 2.0) * math.log(size))
    return weight


@inner
def friction_twist(u: Array, window: Array, wheels: Contacts) -> Array:
    """Displacement (3,) of the newest step (8,), with friction weights from the window's sum (8,)."""
    still = 0.0
    for i in range(8):
        still += abs(window[i])
    if still < 1e-4:
        return weighted_twist(u, np.ones(4), wheels)
    return weighted_twist(u, friction_weights(window, wheels), wheels)


@inner
def creep_twist(u: Array, window: Array, wheels: Contacts) -> Array:
    """Displacement (3,) of the newest step (8,) where creep forces balance; see `hil.robot.contact_laws`.

    Args:
        u: (8,) newest step.
        window: (8,) sum of the last steps: direction and distance that each wheel rolls.
        wheels: contact points of the wheels.
    """
    mean = 1e-9
    for i in range(4):
        mean += 0.25 * math.sqrt(window[2 * i] * window[2 * i] + window[2 * i + 1] * window[2 * i + 1])
    if mean < STILL_M:
        return weighted_twist(u, np.ones(4), wheels)
    a00, a01, a02, a11, a12, a22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    b0, b1, b2 = 0.0, 0.0, 0.0
    for i in range(4):
        nx, ny, x, y = window[2 * i], window[2 * i + 1], wheels.x_m[i], wheels.y_m[i]
        size = math.sqrt(nx * nx + ny * ny)
        rolled = max(size / mean, LEAST_ROLLED)
        across = wheels.across[i] / rolled
        bend = (wheels.load[i] / rolled - across) / max(size * size, 1e-30)
        wxx, wxy, wyy = across + bend * nx * nx, bend * nx * ny, across + bend * ny * ny
        tx, ty = wxy * x - wxx * y, wyy * x - wxy * y
        fx, fy = wxx * u[2 * i] + wxy * u[2 * i + 1], wxy * u[2 * i] + wyy * u[2 * i + 1]
        a00, a01, a11 = a00 + wxx, a01 + wxy, a11 + wyy
        a02, a12, a22 = a02 + tx, a12 + ty, a22 + x * ty - y * tx
        b0, b1, b2 = b0 + fx, b1 + fy, b2 + x * fy - y * fx
    l10, l20 = a01 / a00, a02 / a00
    d1 = a11 - l10 * a01
    l21 = (a12 - l20 * a01) / d1
    y1 = b1 - l10 * b0
    turn = (b2 - l20 * b0 - l21 * y1) / (a22 - l20 * a02 - l21 * l21 * d1)
    left = y1 / d1 - l21 * turn
    return np.array([b0 / a00 - l10 * left - l20 * turn, left, turn])


@inner
def windowed_twist(u: Array, window: Array, decay: float, wheels: Contacts, creeping: bool) -> Array:
    """Displacement (3,) of the newest step by either law; updates the decaying `window` (8,) with it."""
    for i in range(8):
        window[i] = decay * window[i] + u[i]
    return creep_twist(u, window, wheels) if creeping else friction_twist(u, window, wheels)
