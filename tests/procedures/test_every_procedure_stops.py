"""Whatever ends a procedure, at whatever step, no wheel goes on turning.

A saboteur among the sinks strikes while wheels or axes move. The default run strikes every procedure
once; `long` strikes every step in every way.
"""

import os
import signal

import numpy as np
import pytest
from procedure_runs import Nobody, Run, watched

from hil.clock import MonotonicClock
from hil.procedure.guard import LoopGuard
from hil.procedure.parameters import make_parameters
from hil.procedure.runner import RunOptions, run_procedure
from hil.procedure.scripts import load_procedure, shipped_names

SHORT = {
    "bring_up": {"watch_s": 2.0, "devices": "servos,mocap"},
    "grid_scan": {"lanes": 2, "lane_length_m": 0.1, "hold_s": 0.5},
    "imu_calibration": {"rest_s": 5.0, "headings": 4, "dwell_s": 0.5, "learn_s": 4.0},
    "latency": {"reversals": 8, "devices": "imu"},
    "odometry_calibration": {
        "motions": "line_x,rotation_ccw", "repetitions": 2, "validation_repetitions": 1, "line_m": 0.3,
        "turns": 0.1, "max_rounds": 2, "compared_methods": "", "processes": 1,
    },
    "steering_zero": {"sweep_s": 2.0, "sweeps": 1, "leg_m": 0.1, "legs": 1},
    "surface_identification": {"length_m": 0.15, "repetitions": 2, "hold": False},
    "tracker_extrinsics": {"turn_deg": 30.0, "way_m": 0.1, "repetitions": 1},
    "wall_tracking": {
        "cases": "y_line", "feedbacks": "odometry", "optimal": False, "length_m": 0.1, "duration_s": 3.0,
        "hold_s": 0.5,
    },
}  # fmt: skip
EXPECTED = {"exception": 2, "sigterm": 4, "one sigint": 4, "two sigints": 4, "time out": 3}
QUIET_CYCLES = 150
NAMES = shipped_names()


class Saboteur:
    """Strikes once, in a step (any, when None), while something is being moved."""

    def __init__(self, kind, step=None):
        self.kind, self.step, self.struck = kind, step, False
        self.benches = []
        self._now, self._cycles = "", 0
        self._steering = None

    def report(self, what, done, total):
        """Progress of the run: tells which step it is in."""
        if total == 1 and done == 0:
            self._now, self._cycles, self._steering = what, 0, None
        elif total == 1 and what == self.step and not self.struck and self.kind != "time out":
            self.strike()

    def write(self, record):
        if self.struck or self.step not in (None, self._now):
            return
        self._cycles += 1
        before, self._steering = self._steering, record.setpoint.steering_rad
        rolling = np.abs(record.setpoint.wheel_rate_rad_s).max() > 0.3
        steering = before is not None and np.abs(self._steering - before).max() > 0.02
        if rolling or steering or (self.step is not None and self._cycles > QUIET_CYCLES):
            self.strike()

    def close(self):
        pass

    def strike(self):
        self.struck = True
        if self.kind == "exception":
            raise ZeroDivisionError("sabotage")
        if self.kind == "time out":
            guard = next(s for s in self.benches[-1]._sinks if isinstance(s, LoopGuard))
            guard.push_limit("sabotage", 0.05)
        elif self.kind == "sigterm":
            os.kill(os.getpid(), signal.SIGTERM)
        else:
            for _ in range(1 if self.kind == "one sigint" else 2):
                os.kill(os.getpid(), signal.SIGINT)


def sabotaged(name, folder, kind, step=None):
    saboteur = Saboteur(kind, step)
    source = watched(name, extra_sinks=(saboteur,))
    saboteur.benches = source.benches
    options = RunOptions(
        folder, MonotonicClock(), "2026-01-01T00:00:00", SHORT.get(name, {}), operator=Nobody(),
        report=saboteur.report,
    )  # fmt: skip
    return saboteur, Run(run_procedure(load_procedure(name), source, options), source)


def check(saboteur, done, kind):
    result = done.result
    if not saboteur.struck:
        executed = [s["title"] for s in result.facts["steps"]]
        assert kind == "time out" or saboteur.step not in executed
        assert result.error is None
    else:
        assert saboteur.struck
        assert result.exit_code == EXPECTED[kind], result.error
        assert not result.teardown_errors
    if done.source.benches:
        done.assert_held()
    assert (result.folder / "result.json").exists()
    assert (result.folder / "junit.xml").exists()


@pytest.mark.parametrize(
    ("name", "kind"), [(n, list(EXPECTED)[k % len(EXPECTED)]) for k, n in enumerate(NAMES)]
)
def test_a_procedure_struck_while_it_moves_leaves_the_robot_held(tmp_path, name, kind):
    saboteur, done = sabotaged(name, tmp_path / "run", kind)
    assert saboteur.struck
    check(saboteur, done, kind)


def steps_of(name):
    proc = load_procedure(name)
    parameters = make_parameters(proc.parameters, SHORT.get(name, {}), name)
    return [s.title for s in proc.steps(parameters, watched(name).config)]


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", list(EXPECTED))
@pytest.mark.parametrize("name", NAMES)
def test_every_step_of_every_procedure_ends_held(tmp_path, name, kind):
    for number, step in enumerate(steps_of(name)):
        saboteur, done = sabotaged(name, tmp_path / str(number), kind, step)
        check(saboteur, done, kind)
