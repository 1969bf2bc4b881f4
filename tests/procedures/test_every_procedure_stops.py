"""Whatever ends a procedure, at whatever step, no wheel goes on turning, and the run can be resumed.

The default run strikes every procedure in the first step that moves, by an exception and in two more ways,
so that every way has its turn at several procedures; `long` strikes every step in every way, and resumes
every run that was killed.
"""

import pytest
from procedure_runs import Run, options_of, watched
from struck_runs import WAYS, check, struck

from hil.procedure.parameters import make_parameters
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.run_journal import read_journal
from hil.procedure.runner import run_procedure
from hil.procedure.shipped import shipped_names

SHORT = {
    "adhesion_check": {"levels": 3, "dwell_s": 0.5, "slide": False},
    "bring_up": {"watch_s": 2.0, "devices": "servos,mocap"},
    "grid_scan": {"lanes": 2, "lane_length_m": 0.1, "hold_s": 0.5},
    "imu_calibration": {"rest_s": 5.0, "headings": 4, "dwell_s": 0.5, "learn_s": 4.0},
    "latency": {"reversals": 10, "devices": "imu"},
    "odometry_calibration": {
        "motions": "line_x,rotation_ccw",
        "repetitions": 2,
        "validation_repetitions": 1,
        "line_m": 0.3,
        "turns": 0.1,
        "max_rounds": 2,
        "compared_methods": "",
        "processes": 1,
    },
    "sensor_noise": {"rest_s": 2.0, "way_m": 0.2},
    "steering_zero": {"sweep_s": 2.0, "sweeps": 1, "leg_m": 0.1, "legs": 1},
    "surface_identification": {"length_m": 0.2, "repetitions": 4, "hold_step_deg": 2.0},
    "tracker_extrinsics": {"turn_deg": 30.0, "way_m": 0.1, "repetitions": 1},
    "wall_ablation": {"cases": "y_line", "length_m": 0.1, "duration_s": 3.0, "hold_s": 0.5, "processes": 1},
    "wall_tracking": {
        "cases": "y_line",
        "feedbacks": "odometry",
        "optimal": False,
        "length_m": 0.1,
        "duration_s": 3.0,
        "hold_s": 0.5,
    },
}
NAMES = shipped_names()
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


MOVING = [name for name in NAMES if name != "adhesion_check"]
OTHER_WAYS = [way for way in WAYS if way != "exception"]


@pytest.mark.parametrize(("number", "name"), list(enumerate(MOVING)), ids=MOVING)
def test_a_procedure_struck_while_it_moves_leaves_the_robot_held(tmp_path, number, name):
    ways = [OTHER_WAYS[(number + k) % len(OTHER_WAYS)] for k in (0, 2)]
    strikes, done = struck(name, tmp_path / "run", SHORT[name], ways, first=True)
    assert not strikes.problems, "\n".join(strikes.problems)
    assert [way for _, way in strikes.struck] == ways
    check(done, "exception")


def planned(name):
    proc = load_procedure(name)
    parameters = make_parameters(proc.parameters, SHORT[name], name)
    return {s.title for s in proc.steps(parameters, watched(name).config)}


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", NAMES)
def test_every_step_of_every_procedure_ends_held(tmp_path, name):
    folder, killed = tmp_path / "run", tmp_path / "killed"
    strikes, done = struck(name, folder, SHORT[name], WAYS, keep=killed)
    assert not strikes.problems, "\n".join(strikes.problems)
    assert planned(name) <= set(strikes.steps)
    assert {(s, w) for s in strikes.steps for w in WAYS if w != "time out"} <= set(strikes.struck)
    assert {w for _, w in strikes.struck} == set(WAYS)
    assert done.result.exit_code == 0, done.failed or done.result.error
    done.assert_held()
    for path in sorted(killed.iterdir()):
        check_resumed(name, path, done)


def check_resumed(name, folder, undisturbed):
    """What was done before the kill counts, and the figures are those of the undisturbed run."""
    source = watched(name)
    options = options_of(folder, SHORT[name], resume=True)
    before = set(read_journal(folder / "journal.jsonl").checkpoints)
    resumed = Run(run_procedure(load_procedure(name), source, options), source)
    assert resumed.result.exit_code == 0, resumed.failed or resumed.result.error
    assert {s["title"] for s in resumed.result.facts["steps"] if s["outcome"] == "resumed"} == before
    for key, value in undisturbed.values.items():
        assert resumed.values[key] == value, key
