"""The force that counts where several measurements give one: which agree, and which is not believed."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from hil.robot.motor_cross_checks import FORCE_SHARE, POWER, SPEED, VOLTAGE, far

CELLS = "the load cells"
DISAGREE_N, DISAGREE_SHARE = 3.0, 0.1
"""Tolerated difference of two forces."""
_VOLTAGE_SHARE = 0.2
"""The same for a force by duty and voltage: it goes with the square of the speed."""
_ALONE_SHARE = 0.35
"""The same for force by voltage and by power, where nothing else measures it."""
UNCONFIRMED = 1.5
"""Factor on the needed force where no second sensor has measured the force.

A rated force may be a third too high: another seal, another battery, a figure of a data sheet. Then 1.5
times the needed force still holds. Speed, pole pairs and rpm_per_v are checked against each other and need no
margin.
"""


class Believed(NamedTuple):
    """The force on which two measurements agree, or the smallest.

    Attributes:
        force_n: the force, N; NaN without a measurement.
        by: the measurement that gives it; empty without one.
        confirmed: True if two sensors have measured the force: the load cells and the motor's controller.
        against: forces of the measurements that contradict it, N, by name.
    """

    force_n: float
    by: str = ""
    confirmed: bool = False
    against: Mapping[str, float] = {}


def apart(force_n: float, speed_n: float) -> bool:
    """Whether two measures of one force contradict each other; False where one is NaN."""
    return abs(force_n - speed_n) > tolerated_n(speed_n)


def tolerated_n(speed_n: float) -> float:
    """Difference that another measure of a force may have from that by speed, N."""
    return max(DISAGREE_N, DISAGREE_SHARE * abs(speed_n))


def believe(forces: Mapping[str, float], highest_n: float = math.inf) -> Believed:
    """The force that counts, of forces (N) by measurement.

    Load cells measure the force itself, the others the motor. Cells and a measurement of the motor that agree
    confirm each other. Where only the motor is measured, its power decides between speed and voltage. Without
    agreement the smallest force counts.

    Args:
        forces: force by measurement, N.
        highest_n: largest set-point; a force far beyond is not believed.
    """
    possible = {name: n for name, n in forces.items() if n <= FORCE_SHARE * highest_n}
    names, confirmed = _those_that_count(possible)
    if not names:
        return Believed(math.nan, against=dict(forces))
    by = min(names, key=possible.__getitem__)
    force_n = possible[by]
    against = {name: n for name, n in forces.items() if name not in names and _differs(name, n, force_n)}
    if len(names) > 1 and not confirmed:
        against.update({name: possible[name] for name in names if _differs(name, possible[name], force_n)})
    return Believed(force_n, by, confirmed, against)


def _those_that_count(possible: Mapping[str, float]) -> tuple[tuple[str, ...], bool]:
    """Names of the measurements whose smallest counts, and whether two sensors agree."""
    get = possible.get
    cells_n, speed_n, volts_n = get(CELLS, math.nan), get(SPEED, math.nan), get(VOLTAGE, math.nan)
    if SPEED in possible and CELLS in possible and not apart(cells_n, speed_n):
        return (CELLS, SPEED), True
    if VOLTAGE in possible and CELLS in possible and not far(cells_n, volts_n, _VOLTAGE_SHARE):
        return (CELLS, VOLTAGE), True
    split = far(speed_n, volts_n, _VOLTAGE_SHARE)
    if split and CELLS not in possible and POWER in possible:
        return (min((SPEED, VOLTAGE), key=lambda name: abs(possible[name] - possible[POWER])),), False
    alone = SPEED not in possible and CELLS not in possible
    if alone and far(volts_n, get(POWER, math.inf), _ALONE_SHARE):
        return (), False
    voltage = split or SPEED not in possible
    return tuple(n for n in (SPEED, CELLS, *(VOLTAGE,) * voltage) if n in possible), False


def _differs(name: str, force_n: float, believed_n: float) -> bool:
    """Whether a measurement contradicts the believed force; the power only decides, and never counts."""
    if name == POWER:
        return False
    return far(force_n, believed_n, _VOLTAGE_SHARE) if name == VOLTAGE else apart(force_n, believed_n)
