"""The drift of the emulated load cells: with time at first, and then no more."""

import pytest
from still_plant import StillPlant

from hil.config.load_cells import LoadCellsConfig
from hil.fakes.load_cells.hx711.cells import Cells, LoadCellTruthOptions
from hil.fakes.world import World

MINUTE_NS = 60_000_000_000
FORCE_N = 45.0


class Pressed(StillPlant):
    def adhesion_n(self):
        return FORCE_N


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_hour_adds_no_more_than_ten_minutes(seed):
    options = LoadCellTruthOptions(noise_n=0.0, drift_n_per_min=0.1)
    config = LoadCellsConfig()
    cells = Cells(World(Pressed(), seed=seed), config, options)

    def force_n(minutes):
        return sum(n * k for n, k in zip(cells.counts(minutes * MINUTE_NS), config.n_per_count, strict=True))

    begin_n, *later = (force_n(minutes) for minutes in (0, 1, 5, 10, 20, 60))
    one, five, ten, twenty, hour = (n - begin_n for n in later)
    assert abs(ten) > 0.01
    assert five == pytest.approx(5.0 * one, abs=1e-3)
    assert ten == pytest.approx(10.0 * one, abs=1e-3)
    assert twenty == hour == ten
