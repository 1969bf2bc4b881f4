"""What the doctor asks of the load cells: conversions of each, noise, and a zero that was found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.config.load_cells import LoadCellsConfig
from hil.core.finding import Finding, Level
from hil.core.signals import Status
from hil.devices.doctor_watch import Watched, losses

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
            "look what else sends there, and at load_cells.dbc or load_cells.baud",
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
    told = f"{total_n:.1f} N now" + ("" if found_once else "; no zero was ever found")
    yield Finding(
        "load_cells",
        "zero",
        level,
        told,
        "a force >= 0, and load_cells.zero_n of a fan at rest",
        "hil run adhesion_check",
    )
