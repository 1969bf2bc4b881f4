"""The sensors of the filter, one module each, and the kernels that the event loop calls for any of them.

To add a sensor write a module that defines what `hil.estimator.sensors.sensor.Sensor` lists, and put it at
the end of `SENSORS`. Its number is its place there, from 1: events of one stamp are taken in this order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hil.estimator.sensors import gyro, mocap, tracker, wheels
from hil.estimator.sensors.sensor import Sensor
from hil.estimator.state import ROWS
from hil.vocabulary.geometry import Array
from hil.vocabulary.kernels import inner

SENSORS: tuple[Sensor, ...] = (wheels, gyro, tracker, mocap)

MARK = 0
"""Number of an event that is no sample: the start, or a cycle's end."""
NUMBERS = {sensor.NAME: number for number, sensor in enumerate(SENSORS, start=1)}

BENT = (False, *(sensor.BENT for sensor in SENSORS))
ANGLE_ROW = (-1, *(sensor.ANGLE_ROW for sensor in SENSORS))
GATED_TOGETHER = (False, *(sensor.GATED_TOGETHER for sensor in SENSORS))
"""By number, as their names in `Sensor`."""

_OWN = ("m", "row", "par")


def _by_number(name: str, arguments: str) -> Callable[..., Any]:
    """A kernel (number, ...) that calls the kernel of this name of the sensor with that number.

    Args:
        name: as in `Sensor`.
        arguments: its names of arguments; of `m`, `row` and `par` a sensor is given its own part.
    """
    lines = [f"def {name}(number, {arguments}):"]
    scope: dict[str, Any] = {"__name__": __name__}
    for number, sensor in enumerate(SENSORS, start=1):
        scope[f"{name}_{number}"] = getattr(sensor, name)
        passed = (f"{a}.{sensor.NAME}" if a in _OWN else a for a in arguments.split(", "))
        lines.append(f"    if number == {number}:\n        return {name}_{number}({', '.join(passed)})")
    lines[-1] = lines[-1].replace(f"if number == {len(SENSORS)}:", "else:")
    exec(compile("\n".join(lines), __file__, "exec"), scope)
    kernel: Callable[..., Any] = inner(scope[name])
    return kernel


admit = _by_number("admit", "t_ns, m, row, par")
observe = _by_number("observe", "t_ns, m, row, par, z, var, aux")
predicted = _by_number("predicted", "x, aux, par, out")
jacobian = _by_number("jacobian", "x, aux, par, h")
account = _by_number("account", "m, nu, nis, var, count, gate, samples")
let_in = _by_number("let_in", "limit, t_ns, p, m, par")
new_frame = _by_number("new_frame", "t_ns, x, p, m, row, par")
remember = _by_number("remember", "t_ns, x, p, m, row, par")
undo = _by_number("undo", "t_ns, x, m, row, par, late, spread")


@inner
def innovation(number: int, z: Array, mean: Array, var: Array, count: int, nu: Array) -> None:
    """Fill `nu` (8,) with measured minus predicted rows, angles by the shorter way round.

    A row that is not finite is marked in `var`.
    """
    for i in range(ROWS):
        nu[i] = z[i] - mean[i]
    for i in range(count):
        if not math.isfinite(nu[i]):
            nu[i], var[i] = 0.0, -1.0
    angle = ANGLE_ROW[number]
    if angle >= 0:
        nu[angle] = math.pi - (math.pi - nu[angle]) % (2.0 * math.pi)
