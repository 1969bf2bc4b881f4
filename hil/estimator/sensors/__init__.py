"""The sensors of the filter, one module each, and the kernels through which the event loop calls them.

To add a sensor, write a module that defines what `hil.estimator.sensors.sensor.Sensor` lists, append it to
`SENSORS` and add a branch to each function below. Its number is its position in `SENSORS`, from 1; events
with the same stamp are processed in this order. A sensor receives only its own part of memory `m`, event row
`row` and parameters `par`.
"""

import math
from typing import Any

from hil.core.geometry import Array
from hil.estimator.sensors import gyro, mocap, tracker, wheels
from hil.estimator.sensors.sensor import Sensor
from hil.estimator.state_vector import ROWS
from hil.support.numba_jit import inner

SENSORS: tuple[Sensor, ...] = (wheels, gyro, tracker, mocap)

MARK = 0
"""Number of an event without a sample: the start, or the end of a cycle."""
NUMBERS = {sensor.NAME: number for number, sensor in enumerate(SENSORS, start=1)}

NONLINEAR = (False, *(sensor.NONLINEAR for sensor in SENSORS))
ANGLE_ROW = (-1, *(sensor.ANGLE_ROW for sensor in SENSORS))
GATED_TOGETHER = (False, *(sensor.GATED_TOGETHER for sensor in SENSORS))
"""Attributes of `Sensor` of the same names, indexed by sensor number."""


@inner
def admit(number: int, t_ns: float, m: Any, row: Any, par: Any) -> int:
    """`Sensor.admit` of the sensor with this number."""
    if number == 1:
        return wheels.admit(t_ns, m.wheels, row.wheels, par.wheels)
    if number == 2:
        return gyro.admit(t_ns, m.gyro, row.gyro, par.gyro)
    if number == 3:
        return tracker.admit(t_ns, m.tracker, row.tracker, par.tracker)
    return mocap.admit(t_ns, m.mocap, row.mocap, par.mocap)


@inner
def observe(number: int, t_ns: float, m: Any, row: Any, par: Any, z: Array, var: Array, aux: Array) -> int:
    """`Sensor.observe` of the sensor with this number."""
    if number == 1:
        return wheels.observe(t_ns, m.wheels, row.wheels, par.wheels, z, var, aux)
    if number == 2:
        return gyro.observe(t_ns, m.gyro, row.gyro, par.gyro, z, var, aux)
    if number == 3:
        return tracker.observe(t_ns, m.tracker, row.tracker, par.tracker, z, var, aux)
    return mocap.observe(t_ns, m.mocap, row.mocap, par.mocap, z, var, aux)


@inner
def predicted(number: int, x: Array, aux: Array, par: Any, out: Array) -> None:
    """`Sensor.predicted` of the sensor with this number."""
    if number == 1:
        wheels.predicted(x, aux, par.wheels, out)
    elif number == 2:
        gyro.predicted(x, aux, par.gyro, out)
    elif number == 3:
        tracker.predicted(x, aux, par.tracker, out)
    else:
        mocap.predicted(x, aux, par.mocap, out)


@inner
def jacobian(number: int, x: Array, aux: Array, par: Any, h: Array) -> None:
    """`Sensor.jacobian` of the sensor with this number."""
    if number == 1:
        wheels.jacobian(x, aux, par.wheels, h)
    elif number == 2:
        gyro.jacobian(x, aux, par.gyro, h)
    elif number == 3:
        tracker.jacobian(x, aux, par.tracker, h)
    else:
        mocap.jacobian(x, aux, par.mocap, h)


@inner
def account(
    number: int, m: Any, nu: Array, nis: Array, var: Array, count: int, gate: float, samples: float
) -> int:
    """`Sensor.account` of the sensor with this number."""
    if number == 1:
        return wheels.account(m.wheels, nu, nis, var, count, gate, samples)
    if number == 2:
        return gyro.account(m.gyro, nu, nis, var, count, gate, samples)
    if number == 3:
        return tracker.account(m.tracker, nu, nis, var, count, gate, samples)
    return mocap.account(m.mocap, nu, nis, var, count, gate, samples)


@inner
def reanchor(number: int, limit: float, t_ns: float, p: Array, m: Any, par: Any) -> bool:
    """`Sensor.reanchor` of the sensor with this number."""
    if number == 1:
        return wheels.reanchor(limit, t_ns, p, m.wheels, par.wheels)
    if number == 2:
        return gyro.reanchor(limit, t_ns, p, m.gyro, par.gyro)
    if number == 3:
        return tracker.reanchor(limit, t_ns, p, m.tracker, par.tracker)
    return mocap.reanchor(limit, t_ns, p, m.mocap, par.mocap)


@inner
def new_frame(number: int, t_ns: float, x: Array, p: Array, m: Any, row: Any, par: Any) -> None:
    """`Sensor.new_frame` of the sensor with this number."""
    if number == 1:
        wheels.new_frame(t_ns, x, p, m.wheels, row.wheels, par.wheels)
    elif number == 2:
        gyro.new_frame(t_ns, x, p, m.gyro, row.gyro, par.gyro)
    elif number == 3:
        tracker.new_frame(t_ns, x, p, m.tracker, row.tracker, par.tracker)
    else:
        mocap.new_frame(t_ns, x, p, m.mocap, row.mocap, par.mocap)


@inner
def remember(number: int, t_ns: float, x: Array, p: Array, m: Any, row: Any, par: Any) -> None:
    """`Sensor.remember` of the sensor with this number."""
    if number == 1:
        wheels.remember(t_ns, x, p, m.wheels, row.wheels, par.wheels)
    elif number == 2:
        gyro.remember(t_ns, x, p, m.gyro, row.gyro, par.gyro)
    elif number == 3:
        tracker.remember(t_ns, x, p, m.tracker, row.tracker, par.tracker)
    else:
        mocap.remember(t_ns, x, p, m.mocap, row.mocap, par.mocap)


@inner
def undo(number: int, t_ns: float, x: Array, m: Any, row: Any, par: Any, late: Array, spread: Array) -> None:
    """`Sensor.undo` of the sensor with this number."""
    if number == 1:
        wheels.undo(t_ns, x, m.wheels, row.wheels, par.wheels, late, spread)
    elif number == 2:
        gyro.undo(t_ns, x, m.gyro, row.gyro, par.gyro, late, spread)
    elif number == 3:
        tracker.undo(t_ns, x, m.tracker, row.tracker, par.tracker, late, spread)
    else:
        mocap.undo(t_ns, x, m.mocap, row.mocap, par.mocap, late, spread)


@inner
def innovation(number: int, z: Array, mean: Array, var: Array, count: int, nu: Array) -> None:
    """Fill `nu` (8,) with measured minus predicted rows, angles wrapped to (-pi, pi].

    A row that is not finite gets innovation 0 and a negative variance in `var`.
    """
    for i in range(ROWS):
        nu[i] = z[i] - mean[i]
    for i in range(count):
        if not math.isfinite(nu[i]):
            nu[i], var[i] = 0.0, -1.0
    angle = ANGLE_ROW[number]
    if angle >= 0:
        nu[angle] = math.pi - (math.pi - nu[angle]) % (2.0 * math.pi)
