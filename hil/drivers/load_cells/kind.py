"""The kind `load_cells`: cells that measure the force of the fan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hil.config.load_cells import LoadCellsConfig
from hil.core.device import DeviceKind, Figures, Plot, Topic
from hil.core.finding import Finding, Level
from hil.core.signals import Inputs, LoadCellSample, Status
from hil.drivers.doctor_watch import Watched, losses
from hil.drivers.load_cells.hx711.model import Hx711Can, Hx711Line

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["CELLS", "KIND", "cell_state"]


_NEGATIVE_N, _NOISE_N = -2.0, 1.0


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about cells that were watched."""
    config = watched.config
    assert isinstance(config, LoadCellsConfig)
    if malformed := getattr(watched.device, "malformed", 0):
        yield Finding(
            "load_cells",
            "frames",
            "warning",
            f"{malformed} frames or lines that are no conversion",
            "conversions only",
            "find what else sends there; check load_cells.dbc or load_cells.baud",
        )
    for i, label in enumerate(watched.kind.labels):
        statuses = (sample.status[i] for sample in watched.samples)
        found = losses("load_cells", statuses, watched.due, "check the cell's cable and its converter")
        yield replace(found, check=f"{label} samples")
    good = [s.force_n for s in watched.samples if all(status is Status.OK for status in s.status)]
    if not good:
        return
    forces_n = np.array(good) - np.array(config.zero_n)
    noise_n, total_n = float(forces_n.std(axis=0).max()), float(forces_n.mean(axis=0).sum())
    noisy: Level = "ok" if noise_n < _NOISE_N else "warning"
    yield Finding(
        "load_cells",
        "noise",
        noisy,
        f"{noise_n:.2f} N",
        f"below {_NOISE_N:g} N at rest",
        "screen the cells' cables; keep them away from the fan's",
    )
    found_once = config.zero_n != (0.0, 0.0)
    level: Level = "failure" if total_n < _NEGATIVE_N else "ok" if found_once else "warning"
    message = f"{total_n:.1f} N now" + ("" if found_once else "; no zero was ever found")
    yield Finding(
        "load_cells",
        "zero",
        level,
        message,
        "a force >= 0, and load_cells.zero_n of a fan at rest",
        "hil run adhesion_check",
    )


CELLS = ("cell_1", "cell_2")


def cell_state(sample: LoadCellSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState`; effort holds the cells' forces in N, with their zeros."""
    return ros.joints(sample.stamp.t_ns, CELLS, effort=sample.force_n)


class LoadCells(DeviceKind):
    """Two cells between fan and chassis."""

    name, noun, sample = "load_cells", "load cells", LoadCellSample
    models, aliases, labels = (Hx711Can(), Hx711Line()), ("cells",), CELLS
    guards_hold = True
    max_age_s, max_gap_s, min_delivered = 0.02, 0.2, 0.9
    topics = (Topic("/adhesion/cells", "sensor_msgs/msg/JointState", cell_state),)
    plots = (Plot("Adhesion", "Load cells (N)", "adhesion/cells_n"),)
    silent_faults: ClassVar[Mapping[str, str]] = {
        "delayed": "earlier forces are the same while the fan turns steadily"
    }

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.adhesion_stale_s`."""
        return float(safety.adhesion_stale_s)

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Force of each cell."""
        if inputs.load_cells:
            values = inputs.load_cells[-1].force_n.tolist()
            yield "adhesion/cells_n", dict(zip(CELLS, values, strict=True))

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Conversions of each cell, noise, zero."""
        return look(watched)


KIND = LoadCells()
