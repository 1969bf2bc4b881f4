"""Drives cells in front of real devices: motion capture takes the place of the emulated robot's truth.

Before each cell the robot returns, without a fault, to where the first one began. What no device measures, as
the force of a fan without reports, is not judged.
"""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.bench import Bench, open_bench
from hil.bench.device_set_from_config import model_of
from hil.bench.injection import check_links
from hil.config.bench import BenchConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import Aborted, FaultNotSupportedError, HilError, UsageError
from hil.core.geometry import Array
from hil.fault_matrix.cases import BEGUN_S, Cell
from hil.fault_matrix.drive import climb, told_by, unreadable
from hil.fault_matrix.judge import CellVerdict, judge
from hil.fault_matrix.observation import Seen, ended_by
from hil.faults import permission
from hil.faults.fault import Fault, Supported, parse_fault
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import line

if TYPE_CHECKING:
    from hil.core.signals import CycleRecord

DEVICES = "real"
"""Entry of `Cell.plant` for a robot that is not emulated by this program."""
_AT_HOME_M, _HOME_M_S = 0.003, 0.05
_OPENED_FROM = "@0.05"
_REST_S = 0.5
_SPARE_S = 1.0
"""Time by which an opening of the bench may take longer than the first one, s."""


def faults_at_links(config: BenchConfig) -> dict[str, Supported]:
    """Faults and their options, by device, that a bench file permits in front of its real devices.

    Raises:
        UsageError: the bench has no real device, or the robot hangs without a tether.
        FaultNotSupportedError: the bench file permits no faults where the robot is.
    """
    real = [name for name in config.devices() if name not in config.emulated()]
    if not real:
        raise UsageError(
            f"--inject-real: bench {config.name} has no real device",
            expected='a device with backend = "real"',
            remedy="leave --inject-real out: emulated devices have their faults at the chip",
        )
    if config.environment.on_wall and not config.safety.tethered:
        raise UsageError(
            "--inject-real: the robot hangs on a wall without a tether",
            expected="a robot on the floor, or on a tether (safety.tethered = true)",
            remedy="`hil run --fault ... --inject-real` injects a single fault that is permitted there",
        )
    found: dict[str, Supported] = {}
    for name in (name for name in config.faults.devices if name in real):
        wire = model_of(config, name).wire_of(config.devices()[name])
        found[name] = dict(permission.BY_WIRE.get(wire, {}))
    if not found:
        raise FaultNotSupportedError(
            f"{config.name} permits no faults of its real devices",
            expected="devices = [...] in [faults] of the bench file, of " + ", ".join(real),
        )
    probes = [Fault(name, kind, start_ns=1) for name, kinds in found.items() for kind in kinds]
    check_links(config, probes, consent=True)
    return found


class DeviceCells:
    """Runs the cells of a campaign on one bench with real devices, in order.

    Args:
        bench: bench file.
    """

    def __init__(self, bench: str) -> None:
        self._bench = bench
        self._home: Array | None = None
        self._begun_s, self._astray_m = BEGUN_S, -1.0

    def run(self, cell: Cell) -> CellVerdict:
        """Run one cell; return its verdict.

        Raises:
            HilError: the robot cannot return to where the first cell began.
        """
        start, _ = self.back()
        if self._astray_m < 0.0:
            self._without_fault(start)
            start, _ = self.back()
        seen, left = self._drive(cell, start)
        _, found = self.back()
        seen.crept_m = 0.0 if left is None else float(np.hypot(*(found - left)[:2]))
        seen.effect_m = max(0.0, seen.astray_m - self._astray_m)
        return judge(cell, seen)

    def back(self) -> tuple[Array, Array]:
        """Drive back to the start without a fault; return where the robot stands then, and stood before.

        Both are poses (3,): m, m, rad in the wall frame.
        """
        with open_bench(self._bench) as bench:
            found = stands = bench.settle(_REST_S)
            self._home = found if self._home is None else self._home
            way_m = float(np.hypot(*(found - self._home)[:2]))
            if way_m > _AT_HOME_M:
                bench.drive(line(found, self._home, duration_s=1.0 + way_m / _HOME_M_S), start_pose=found)
                stands = bench.settle(_REST_S)
        return stands, found

    def _without_fault(self, start: Array) -> None:
        """Note when a drive without a fault begins, and how far it is from its reference."""
        seen, begun = Seen(), list[int]()
        with open_bench(self._bench) as bench:
            climb(bench, seen, [], _Capture(start, begun, bench), start)
        if seen.stop is not None or not begun:
            raise Aborted(
                f"the drive without a fault was stopped: {'' if seen.stop is None else seen.stop.text}",
                remedy="`hil doctor` and `hil run bring_up` say why",
            )
        self._begun_s, self._astray_m = begun[0] / NS_PER_S + _SPARE_S, seen.astray_m

    def _at_their_moment(self, cell: Cell) -> list[Fault]:
        """Faults of a cell; those after the opening begin by the time at which this bench is open."""
        late_ns = nanoseconds(max(0.0, self._begun_s - BEGUN_S))
        faults = []
        for spec in cell.specs:
            fault = parse_fault(spec)
            shift_ns = 0 if _OPENED_FROM in spec else late_ns
            end_ns = None if fault.end_ns is None else fault.end_ns + shift_ns
            faults.append(replace(fault, start_ns=fault.start_ns + shift_ns, end_ns=end_ns))
        return faults

    def _is_in_time(self, cell: Cell, bench: Bench) -> bool:
        """Rest until the drive of a cell is to begin; False if this bench was opened too late for that."""
        if all(_OPENED_FROM in spec for spec in cell.specs):
            return True
        rest_s = self._begun_s - bench.world_ns / NS_PER_S
        if rest_s < 0.0:
            self._begun_s += _SPARE_S - rest_s
            return False
        bench.observe(rest_s)
        return True

    def _drive(self, cell: Cell, start: Array) -> tuple[Seen, Array | None]:
        """Return what was seen, and the pose at the end, (3,); None if unknown."""
        seen, left = Seen(at_links=True), None
        faults = self._at_their_moment(cell)
        with tempfile.TemporaryDirectory(prefix="hil-faults-") as folder:
            path = Path(folder) / "run.mcap"
            bench = open_bench(self._bench, seed=cell.seed, faults=faults, inject_real=True)
            bench.warns_not_held, seen.on_wall = False, bench.on_wall
            try:
                with bench:
                    bench.add_sink(McapRecorder(str(path), bench.header(), lossless=False))
                    if not self._is_in_time(cell, bench):
                        return self._drive(cell, start)
                    climb(bench, seen, [], _Capture(start, [], bench), start)
                    seen.stopped_s = bench.clock.now_ns() / NS_PER_S
                    bench.look()
                    with contextlib.suppress(HilError):
                        left = bench.settle(_REST_S)
            except HilError as error:
                seen.error = ended_by(error)
            except Exception as error:  # the campaign looks for errors that no device may raise
                seen.foreign = f"{type(error).__name__}: {error}"
            seen.unreadable = unreadable(path) if seen.cycles else ""
        seen.held = bench.held if bench.held.opened else None
        seen.looked_s = bench.clock.now_ns() / NS_PER_S
        seen.moved_m = bench.held.moved_m or 0.0
        seen.missed = ", ".join(map(str, (*bench.faults_without_effect(), *bench.faults_not_met())))
        seen.events = told_by(bench)
        return seen, left


class _Capture:
    """Place of the robot by motion capture, (2,) m from where the drive begins; None while unknown.

    Args:
        start: pose (3,) at which the drive begins.
        begun: list that receives the world time of the first cycle, ns.
        bench: bench of the drive.
    """

    def __init__(self, start: Array, begun: list[int], bench: Bench) -> None:
        self._start, self._begun, self._bench = start, begun, bench
        self._blind = any(fault.device == "mocap" for fault in bench.faults) or not bench.has("mocap")

    def __call__(self, record: CycleRecord) -> Array | None:
        """Newest place, if motion capture is trusted and has one in this cycle."""
        if not self._begun:
            self._begun.append(self._bench.world_ns)
        valid = [one.pose for one in record.measurements.mocap if one.valid]
        return None if self._blind or not valid else valid[-1][:2] - self._start[:2]
