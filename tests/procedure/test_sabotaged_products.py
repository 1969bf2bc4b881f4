"""Products that are broken on purpose are red in the fault matrix, whatever they say of themselves."""

from dataclasses import replace

from hil.bench.hold.hold_check import HoldMonitor
from hil.fault_matrix import MOMENTS, Cell, run_cell
from hil.fault_matrix.drive import observed
from hil.fault_matrix.judge import judge
from hil.loop.checks.exclusion import Exclusion
from hil.loop.supervisor import Supervisor

EVERY = ("adhesion", "encoders", "imu", "load_cells", "mocap", "servos", "thrust", "tracker")


def cell(device, fault, options=""):
    return Cell(device, fault, "motion", 0, "own", (f"{device}:{fault}{MOMENTS['motion']}{options}",))


def why(struck):
    return "; ".join(run_cell(struck).why)


def test_a_product_without_checks_goes_on_in_silence(monkeypatch):
    monkeypatch.setattr(Supervisor, "check_samples", lambda self, cycle: None)
    monkeypatch.setattr(Supervisor, "check_estimate", lambda self, cycle: None)
    assert "went on and named no device" in why(cell("tracker", "wrong", ",scale=1.5"))


def test_a_product_that_accuses_every_device_accuses_none(monkeypatch):
    monkeypatch.setattr("hil.core.errors.suspects_of", lambda reason: EVERY)
    assert "names 8 kinds of devices" in why(cell("servo.steer_FL", "jump"))


def test_a_product_that_lets_go_is_seen_under_every_word(monkeypatch):
    looked = HoldMonitor.look

    def let_go(self, limit_s, **how):
        held = looked(self, limit_s, **how)
        self._devices.servos.release()
        return replace(held, state="not needed")

    monkeypatch.setattr(HoldMonitor, "look", let_go)
    struck = cell("servo.steer_FL", "jump")
    seen = observed(struck)
    for state, expected in (
        ("not needed", "need not be held, on a wall"),
        ("NOT HELD", "after the report"),
        ("HELD", "said to be held, and moved"),
    ):
        seen.held = replace(seen.held, state=state, why="steer_FL")
        assert expected in "; ".join(judge(struck, seen).why)


def test_a_product_that_measures_with_what_it_left_out_is_caught_and_held_is_judged_without_it(monkeypatch):
    struck = cell("mocap", "wrong", ",offset_m=0.012")
    good = observed(struck)
    assert judge(struck, good).why == ()
    assert (good.figures.marked, good.state) == (True, "HELD")
    monkeypatch.setattr(Exclusion, "without_excluded", lambda self, measurements: measurements)
    monkeypatch.setattr("hil.loop.driven_motion.CAPTURE", "nobody")
    assert "without a mark" in why(struck)


def test_a_camera_that_was_voted_out_does_not_keep_a_robot_from_being_held():
    struck = cell("tracker", "wrong", ",drift_x_m_s=-0.05")
    seen = observed(struck)
    assert seen.state == "HELD", seen.held
    assert "camera" not in seen.held.why
    assert judge(struck, seen).why == ()
