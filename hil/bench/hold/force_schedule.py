"""Sets the fan's force by posture, surface and tilt, with a margin, to spare the battery."""

import contextlib
import math

from hil.bench.loop_settings import adhesion_limits, force_wanted_n, thrust_wanted_n
from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.core.clock import nanoseconds
from hil.core.errors import HilError
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.loop.device_set import DeviceSet
from hil.robot.believed_force import apart

_EVERY_NS = nanoseconds(0.5)
_MARGIN = 1.1
"""Factor on the force limit below which the robot is stopped."""
LARGEST_STEP_DOWN_N, _CHANGE_N = 0.5, 0.25
"""Largest step that is not taken for a loss of force; smallest change that is reported."""
_RAISED_N = 2.0
"""A fan that exceeds the set-point of this class by so much was raised by a stop."""


class ForceController(Sink):
    """Sink that sets the fan's force by the present heading.

    Args:
        config: configuration of a bench with a fan on a wall.
        devices: devices of the bench.
    """

    def __init__(self, config: BenchConfig, devices: DeviceSet) -> None:
        self._limits, self._devices = adhesion_limits(config), devices
        self._thrust_n = thrust_wanted_n(config)
        self._asked_n = force_wanted_n(config)
        fan = config.of(AdhesionConfig)
        self._highest_n = self._asked_n if fan is None else fan.highest_force_n
        self._next_ns = 0

    def write(self, record: CycleRecord) -> None:
        """Adjust the force twice a second: raise it at once, lower it in small steps.

        It is lowered only while load cells and fan agree on it.
        """
        t_ns = record.inputs.t_ns
        if t_ns < self._next_ns or self._limits is None or "adhesion_n" not in record.state.diagnostics:
            return
        heading_rad = float(record.state.pose_body_in_wall[2])
        if not math.isfinite(heading_rad):  # the robot has been stopped
            return
        self._next_ns = t_ns + _EVERY_NS
        wanted_n = min(_MARGIN * self._limits.limit_n(self._thrust_n, heading_rad), self._highest_n)
        found = record.state.diagnostics
        runs_n, cells_n = found.get("adhesion_fan_n", math.nan), found.get("adhesion_cells_n", math.nan)
        agree = math.isfinite(runs_n) and math.isfinite(cells_n) and not apart(cells_n, runs_n)
        if agree and runs_n > self._asked_n + _RAISED_N:
            self._asked_n = min(runs_n, self._highest_n)
        force_n = max(wanted_n, self._asked_n - LARGEST_STEP_DOWN_N if agree else self._asked_n)
        if abs(force_n - self._asked_n) < _CHANGE_N:
            return
        with contextlib.suppress(HilError):
            self._devices.get("adhesion").set_force_n(force_n)
            self._asked_n = force_n

    def close(self) -> None:
        """Do nothing: the fan keeps its last set-point."""


def by_need(config: BenchConfig, devices: DeviceSet) -> tuple[Sink, ...]:
    """The sink that adjusts the force of a bench, if `adhesion.by_need` is set."""
    fan = config.of(AdhesionConfig)
    on = fan is not None and fan.by_need and config.environment.on_wall
    return (ForceController(config, devices),) if on else ()
