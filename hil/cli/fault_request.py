"""Request of `hil faults`: what it was asked for; the cells of real devices, and what runs them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hil.core.errors import UsageError

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig
    from hil.fault_matrix import Cell, CellVerdict

DEFAULTS = {"moments": "open,motion,stop,second", "plants": "own", "bench": "emulated"}


@dataclass(frozen=True)
class Asked:
    """Options that choose the cells, as given."""

    quick: bool
    seeds: str
    only: tuple[str, ...]
    moments: str
    plants: str
    count: int | None
    bench: str
    inject_real: bool = False


def cells_at_links(
    asked: Asked, config: BenchConfig, seeds: Sequence[int], moments: Sequence[str]
) -> tuple[Cell, ...]:
    """The selected cells of real devices."""
    from hil.fault_matrix import cells_of, quick_cells, random_cells
    from hil.fault_matrix.on_devices import DEVICES, faults_at_links

    supported, plants = faults_at_links(config), (DEVICES,)
    if asked.quick:
        return quick_cells(supported, seeds=seeds, plants=plants)
    if asked.count is not None:
        return random_cells(supported, count=asked.count, seeds=seeds, plants=plants)
    return cells_of(supported, seeds=seeds, plants=plants, moments=moments, only=asked.only)


def on_devices(asked: Asked, bench: str, workers: int) -> Callable[[Cell], CellVerdict]:
    """The function that runs a cell on real devices; raises `UsageError` for several of them at once."""
    from hil.fault_matrix.on_devices import DeviceCells

    if workers or asked.plants != DEFAULTS["plants"]:
        raise UsageError(
            "--inject-real: there is one robot, and it is no plant of this program",
            expected="neither --workers nor --plants",
        )
    return DeviceCells(bench).run
