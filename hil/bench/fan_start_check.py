"""Checks a fan that `hil adhesion on` starts: its reports against each other, and against the load cells."""

import contextlib
from typing import Any

import numpy as np

from hil.bench.device_set_from_config import make_device_set
from hil.bench.fan_interlock import DEVICE, watched
from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.load_cells import LoadCellsConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError
from hil.core.signals import AdhesionSample
from hil.loop.checks.adhesion_limits import FanForces
from hil.robot.believed_force import apart

_DOUBTS = 10
"""Number of contradicted reports in a row after which the fan is not raised further."""


class FanStartCheck:
    """Check of a fan's reports by each other and by the load cells.

    Args:
        config: configuration of its bench.
        table: its table in the bench file.
    """

    def __init__(self, config: BenchConfig, table: AdhesionConfig) -> None:
        self._config, self._table = config, table
        self._fan, self._doubts = FanForces(table.ratings()), 0

    def contradiction(self, sample: AdhesionSample) -> str:
        """What contradicts the reports for a while; empty for nothing."""
        self._fan.take(sample)
        self._doubts = self._doubts + 1 if self._fan.contradiction else 0
        return self._fan.contradiction if self._doubts >= _DOUBTS else ""

    def force_n(self, sample: AdhesionSample) -> float:
        """Force by the reported speed, N."""
        return self._table.force_at_n(sample.speed_rpm)

    def by_cells(self, is_n: float, clock: MonotonicClock) -> str:
        """What the load cells say against a force; empty where they agree, or there are none."""
        cells = self._config.of(LoadCellsConfig)
        if cells is None or cells.backend == "emulated":
            return ""
        device: Any = make_device_set(self._config, clock, {}).get("load_cells")
        device.open()
        with contextlib.closing(device):
            felt = [float(np.sum(s.force_n)) - sum(cells.zero_n) for s in watched(device, clock)]
        if not felt:
            return "the load cells measure nothing usable"
        felt_n = float(np.median(felt))
        if not apart(felt_n, is_n):
            return ""
        return f"the load cells measure {felt_n:.1f} N, and the speed is good for {is_n:.1f} N"


def contradicted(wrong: str) -> DeviceError:
    """The error for measurements that contradict each other."""
    return DeviceError(
        DEVICE,
        f"{wrong}: what presses the robot is not known, and the fan is taken back to how it ran before",
        expected="load cells, speed, duty and voltage that agree",
        remedy="look at adhesion.controller_id (another motor may answer), adhesion.pole_pairs and "
        "rated_rpm, load_cells.zero_n, and the seal",
    )
