"""What the doctor says of load cells and fan together: a force that no fan makes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.load_cells import LoadCellsConfig
from hil.vocabulary.finding import Finding
from hil.vocabulary.signals import Status, worst

_REST_N, _FELT_N = 1.0, 5.0


def unexplained_force(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[Finding]:
    """A finding where the cells feel a force while the fan says that it is at rest; none where they agree.

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
    if fan.force_at_n(speed_rpm) > _REST_N or felt_n < _FELT_N:
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
