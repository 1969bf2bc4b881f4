"""Finds wheel angles that were integrated from rounded wheel rates.

An angle that an encoder counts alternates between two steps from row to row, so that it is never off by more
than a count. Integrated from a rate in whole units it takes the same step again and again, and what the rate
was rounded by adds up with the way. Both are told apart by how often a step is the same as the one before,
where all rates are whole multiples of one unit, whatever the motion.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.cleaning import INTEGRATED
from hil.datasets.wheel_log import Recording

_ALIKE, _ROLLS, _TYPICAL, _FEWEST = 1e-4, 0.3, 90.0, 200
"""Share of a typical rate up to which two rates are the same, and from which on a wheel rolls."""
_UNIT, _WHOLE, _MULTIPLES, _SAME = 2e-3, 0.05, 0.95, 0.9
"""Least unit as a share of a typical rate; part of a unit, and share of the rates, that are whole multiples;
share of rows with the step of the row before."""
_OUTER, _SAME_UNIT, _OTHER_RATE = (10.0, 90.0), 1.08, 1.15
_RECORDINGS, _IN_MOST, _MOST_WHEELS = 3, 0.5, 3


def with_integrated_angles(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name wheel angles that were integrated from rounded rates.

    Three wheels of a recording have to show it, in half of the recordings and at least three. Angles that
    were integrated here, of logs that hold rates alone, are left as they are: their repairs say so.
    """
    checked = [k for k, one in enumerate(recordings) if not one.of_twist and INTEGRATED not in one.repairs]
    found = {k: units for k in checked if len(units := _units_rad_s(recordings[k])) >= _MOST_WHEELS}
    if len(found) < max(_RECORDINGS, _IN_MOST * len(checked)) or not _of_rates(found.values()):
        return list(recordings)
    out = list(recordings)
    for k, units in found.items():
        unit, lost = (float(np.median(values)) for values in zip(*units, strict=True))
        said = (
            f"its wheel angles (phi) grow by whole multiples of {unit:.4f} rad/s, and by the same from row "
            "to row, where counted angles alternate: they were integrated from rounded rates, and miss up to "
            f"{100.0 * lost:.1f} % of the way; take the angles that the encoders count"
        )
        out[k] = out[k].contradicted(said)
    return out


def _of_rates(found: Iterable[Sequence[tuple[float, float]]]) -> bool:
    """Whether units, with their shares of the typical rates, are alike although these rates differ.

    Without any rounding a steady start gives whole multiples, too: of a unit that grows with the rate.
    """
    units, shares = np.array([pair for pairs in found for pair in pairs]).T
    low, high = np.percentile(units, _OUTER)
    slow, fast = np.percentile(units / shares, _OUTER)
    return bool(high < _SAME_UNIT * low and fast > _OTHER_RATE * slow)


def _units_rad_s(one: Recording) -> list[tuple[float, float]]:
    """Unit of the rate of each wheel that shows one, rad/s, and the share of a typical rate that it is."""
    steps, lasts_s = np.diff(one.wheel_angle_rad, axis=0), np.diff(one.t_s)
    usual_s = float(np.median(lasts_s)) if len(lasts_s) else 1.0
    found = list[tuple[float, float]]()
    for i in range(len(WHEELS)):
        for rate in (steps[:, i] / lasts_s, steps[:, i] / usual_s):
            if unit := _unit(rate):
                found.append((unit, unit / float(np.percentile(np.abs(rate), _TYPICAL))))
                break
    return found


def _unit(rate: Array) -> float:
    """The unit of which rates (n,) are whole multiples, where they stay the same from row to row; else 0."""
    typical = float(np.percentile(np.abs(rate), _TYPICAL)) if len(rate) > _FEWEST else 0.0
    rolls = np.abs(rate) > _ROLLS * typical
    both = rolls[1:] & rolls[:-1]
    if typical <= 0.0 or np.count_nonzero(both) < _FEWEST:
        return 0.0
    same = np.abs(np.diff(rate)) < _ALIKE * typical
    levels = np.unique(np.round(np.abs(rate) / (_ALIKE * typical))) * _ALIKE * typical
    apart = np.diff(levels)
    apart = apart[apart > 5.0 * _ALIKE * typical]
    if np.mean(same[both]) < _SAME or len(apart) < 3:
        return 0.0
    unit = _fine(np.abs(rate), float(apart.min()))
    multiple = np.abs(rate) / unit
    whole = np.abs(multiple - np.round(multiple)) < _WHOLE
    many = np.mean(whole[np.abs(rate) > 0.5 * unit]) >= _MULTIPLES
    return unit if unit > _UNIT * typical and many else 0.0


def _fine(rate: Array, unit: float) -> float:
    """A unit made more exact by all rates (n,), from the lowest to the highest ones."""
    for most in (4.0, 16.0, 64.0, 256.0):
        some = rate[(rate > 0.5 * unit) & (rate < most * unit)]
        number = np.round(some / unit)
        if len(some):
            unit = float(some @ number / (number @ number))
    return unit
