"""Servos whose values are of some time ago: irregular ones are named, and both cost millimetres."""

import contextlib

import numpy as np
import pytest

import hil
from hil.core.errors import HilError
from hil.fakes.servos.dynamixel.sensing import _ROWS, GRID_NS, Sensing
from hil.robot.trajectories import line
from tests.selected import every

OLD = "servos:delayed@2.0,delay_s=0.05"


def driven(seed, plant="own", faults=()):
    """Climb sideways: largest error of the estimate after 2 s, m, and the devices that were warned about."""
    off_m, named = [0.0], set()
    keys = {"exit.look_after_s": 1.0, "emulation.plant": plant}
    with hil.open_bench("emulated", seed=seed, overrides=keys, faults=list(faults)) as bench:

        def see(record):
            true = bench.truth().pose_body_in_wall
            off_m.append(float(np.hypot(*(record.state.pose_body_in_wall - true)[:2])))
            named.update(event.source for event in record.events if event.level == "warning")

        with contextlib.suppress(HilError):
            bench.drive(line((0, 0, 0), (0, 0.3, 0), duration_s=5.0), feedback="ekf", on_cycle=see)
    return np.nanmax(off_m), named


@pytest.mark.parametrize("plant", every(2, ["own", "mujoco"]))
def test_values_of_some_time_ago_move_as_smoothly_as_present_ones(plant):
    off_m, named = driven(8526, plant, [OLD])
    assert off_m < 0.01
    assert not named


def test_irregular_values_name_the_servos(monkeypatch):
    def of_the_grid(self, age_ns=0):
        self._count()
        back = (age_ns + GRID_NS - 1) // GRID_NS
        return [int(n) for n in self._history[(self._row - back) % _ROWS]] if age_ns else now(self)

    now = Sensing.counts
    monkeypatch.setattr(Sensing, "counts", of_the_grid)
    off_m, named = driven(8526, faults=[OLD])
    assert off_m > 0.005
    assert any("servos" in who for who in named)
