"""The fan's force by its controller and by the load cells: what each says about the other's keys."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.load_cells import LoadCellsConfig
from hil.core.cross_check import CrossCheck, Unit
from hil.core.signals import Status, worst
from hil.robot.believed_force import apart, tolerated_n
from hil.robot.motor_cross_checks import Reading, cross_check, is_steady

_STEADY_SHARE = 0.02
"""Share of the rated speed by which the speed may change while its force is compared with the load cells."""
_LEAST_N = 5.0
"""Force from which the scales show in it."""
_RATED_N, _RATED_RPM = "adhesion.rated_force_n", "adhesion.rated_rpm"
_SCALE, _ZERO = "load_cells.n_per_count", "load_cells.zero_n"
_CELLS, _SPEED = "the load cells", "the fan's speed"
_GIVEN = {_RATED_N: (_SCALE,), _RATED_RPM: (_SCALE,), _SCALE: (_RATED_N,), _ZERO: (_RATED_N, _SCALE)}
"""Which other key the comparison takes as right: twice the force of both would not show."""
_ONE_CELL = "how the force divides among the cells"


def force_checks(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[CrossCheck]:
    """Compare the reports of the fan with each other, and with the load cells.

    Args:
        config: configuration of the bench.
        seen: samples of the resting robot, by kind.
    """
    fan = config.of(AdhesionConfig)
    usable = [s for s in seen.get("adhesion", ()) if s.status is Status.OK]
    if fan is None or not usable:
        return
    speeds = [s.speed_rpm for s in usable]
    middle = Reading(*(_middle([float(getattr(s, name)) for s in usable]) for name in Reading._fields))
    steady = max(speeds) - min(speeds) < _STEADY_SHARE * fan.rated_rpm
    ratings = fan.ratings()
    own = cross_check(ratings, middle, steady=is_steady(ratings, speeds, middle.speed_rpm))
    yield from (
        _by_power(config, fan, seen, middle, own)
        if own.state == "contradicted" and own.by == "power"
        else (own,)
    )
    if own.state == "confirmed" and (rpm_per_v := getattr(fan, "rpm_per_v", None)) is not None:
        yield CrossCheck(
            "adhesion.rpm_per_v", rpm_per_v, "confirmed", own.by, rpm_per_v, own.difference, within=own.within
        )
    if own.state != "contradicted" and steady and not config.force_sensor_elsewhere():
        yield from _by_cells(config, fan, seen, middle.speed_rpm)


def _by_power(
    config: BenchConfig, fan: AdhesionConfig, seen: Mapping[str, Sequence[Any]], now: Reading, own: CrossCheck
) -> Iterator[CrossCheck]:
    """Contradictions of all keys that a power which does not belong to the speed may mean.

    Load cells that agree with the speed leave the ratings of the power.
    """
    ratio = (1.0 + own.difference) ** -3.0  # of the power to that of the speed
    rows = {
        "adhesion.rated_input_a": fan.rated_input_a * ratio,
        "adhesion.rated_input_v": fan.rated_input_v * ratio,
    }
    cells = list(_by_cells(config, fan, seen, now.speed_rpm)) if not config.force_sensor_elsewhere() else []
    if not any(check.state == "confirmed" for check in cells):
        rows[own.key] = own.says
        for key in ("adhesion.pole_pairs", "adhesion.rpm_per_v") if "both" in own.text else ():
            rows[key] = math.nan
    for key, says in rows.items():
        value = getattr(fan, key.partition(".")[2])
        yield own._replace(key=key, value=value, says=says)


def _by_cells(
    config: BenchConfig, fan: AdhesionConfig, seen: Mapping[str, Sequence[Any]], speed_rpm: float
) -> Iterator[CrossCheck]:
    cells, made_n = config.of(LoadCellsConfig), fan.force_at_n(speed_rpm)
    forces_n = [s.force_n for s in seen.get("load_cells", ()) if worst(s) is Status.OK]
    if cells is None or not forces_n or not made_n > _LEAST_N:
        return
    felt_n = float(np.sum(np.mean(forces_n, axis=0) - np.array(cells.zero_n)))
    share = felt_n / made_n
    within_n = tolerated_n(made_n)
    rated, within = fan.rated_force_n, within_n / made_n
    # the force goes with the square of the speed; of the cells only the sum is compared
    rows: tuple[tuple[str, Any, str, Any, float, float, Unit], ...] = (
        (_RATED_N, rated, _CELLS, rated * share, share - 1.0, within, "1"),
        (
            _RATED_RPM,
            fan.rated_rpm,
            _CELLS,
            _rpm(fan.rated_rpm, share),
            0.5 * (share - 1.0),
            0.5 * within,
            "1",
        ),
        (_SCALE, cells.n_per_count, _SPEED, math.nan, share - 1.0, within, "1"),
        (_ZERO, cells.zero_n, _SPEED, math.nan, felt_n - made_n, within_n, "N"),
    )
    wrong = apart(felt_n, made_n)
    text = (
        f"{felt_n:.1f} N by the load cells, {made_n:.1f} N by the fan's speed: either "
        f"{', '.join(row[0] for row in rows)} is wrong, or the seal leaks; `hil run adhesion_check` finds "
        "zero and rated force"
    )
    for key, value, by, says, off, most, unit in rows:
        if wrong:
            yield CrossCheck(key, value, "contradicted", by, says, off, text, unit=unit)
        else:
            given, beside = _GIVEN[key], _ONE_CELL if key.startswith("load_cells.") else ""
            yield CrossCheck(
                key, value, "confirmed", by, value, off, beside=beside, within=most, unit=unit, given=given
            )


def _rpm(rated_rpm: float, share: float) -> float:
    return rated_rpm / math.sqrt(share) if share > 0.0 else math.nan


def _middle(values: Sequence[float]) -> float:
    """Median of the values that are known; NaN for none."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan
