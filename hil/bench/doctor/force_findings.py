"""What the doctor says of load cells and fan together: a force that the fan does not make."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.load_cells import LoadCellsConfig
from hil.core.finding import Finding
from hil.core.signals import Status, worst
from hil.loop.checks.adhesion import DISAGREE_N, DISAGREE_SHARE, apart

_REST_N, _FELT_N = 1.0, 5.0


def unexplained_force(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[Finding]:
    """Whether the cells feel what the fan makes by its speed; of a fan at rest only where they do not.

    A cell's zero that is not what it was when `adhesion_check` found it is seen by that.

    Args:
        config: of the bench.
        seen: samples of every kind that was watched.
    """
    fan, cells = config.of(AdhesionConfig), config.of(LoadCellsConfig)
    speeds_rpm = [s.speed_rpm for s in seen.get("adhesion", ()) if s.status is Status.OK]
    forces_n = [s.force_n for s in seen.get("load_cells", ()) if worst(s) is Status.OK]
    if fan is None or cells is None or not speeds_rpm or not forces_n:
        return
    speed_rpm = float(np.max(np.abs(speeds_rpm)))
    felt_n = float(np.sum(np.mean(forces_n, axis=0) - np.array(cells.zero_n)))
    made_n = fan.force_at_n(float(np.mean(np.abs(speeds_rpm))))
    if made_n > _REST_N:
        yield _of_a_running_fan(felt_n, made_n)
        return
    if felt_n < _FELT_N:
        return
    yield Finding(
        "load_cells",
        "force without fan",
        "warning",
        f"the cells feel {felt_n:.1f} N, and the fan is at rest ({speed_rpm:.0f} 1/min)",
        f"at most {_FELT_N:g} N while the fan is at rest",
        "if a tether or a hand presses the robot on, start the fan before you let go (hil adhesion on); "
        "if nothing does, find the zero of the cells (hil run adhesion_check); "
        "if the fan turns, check its status message 1",
    )


def _of_a_running_fan(felt_n: float, made_n: float) -> Finding:
    return Finding(
        "load_cells",
        "force against the fan's speed",
        "failure" if apart(felt_n, made_n) else "ok",
        f"{felt_n:.1f} N by the cells, {made_n:.1f} N by the fan's speed",
        f"within {DISAGREE_N:g} N, or {100.0 * DISAGREE_SHARE:g} %",
        "look at the seal and at what touches the cells; then `hil run adhesion_check`, which finds "
        "load_cells.zero_n and adhesion.rated_force_n",
    )
