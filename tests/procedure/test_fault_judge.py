"""The judge of the fault campaign, judged itself: made-up runs, good ones and bad ones of every kind."""

from dataclasses import replace

import numpy as np
import pytest

from hil.bench import Held
from hil.core.errors import DeviceError, SafetyStop
from hil.procedure.faults import MOMENTS, Cell, CellVerdict, matrix_page, summary
from hil.procedure.faults.judge import Measured, judge
from hil.procedure.faults.movement_bounds import LIMP_M_S, farthest_m
from hil.procedure.faults.observation import Ended, Seen, ended_by

STOPPED_S, LOOKED_S = 1.4, 6.4


def cell(device="imu", fault="wrong", moment="motion"):
    return Cell(device, fault, moment, 0, "own", (f"{device}:{fault}{MOMENTS[moment]}",))


def held(state="HELD", why="torque on"):
    return Held(state, 0.0, why)


def seen(**given):
    good = {"cycles": 300, "held": held(), "events": [("imu",)], "stopped_s": STOPPED_S, "looked_s": LOOKED_S}
    return Seen(**{**good, **given})


def why(struck=None, **given):
    return "; ".join(judge(cell() if struck is None else struck, seen(**given)).why)


IMU_STOP = Ended("SafetyStop: robot stopped (stale_imu): silent", "stale_imu", ("imu",))
SERVO_STOP = Ended("SafetyStop: robot stopped (blocked): at the maximum of its imu", "blocked", ("servos",))
NOT_HELD = held("NOT HELD", "it slides")
FELL = {"fallen": True, "held": NOT_HELD, "moved_m": 1.0, "crept_m": 9.0}

MUTANTS = {
    "a fall while another device than the struck one let go": {**FELL, "adhesion_n": 3.0},
    "a fall while propellers let go that were not struck": {**FELL, "thrust_n": 3.0},
    "a fall that nothing explains": FELL,
    "a stop that accuses another device, with the noun of the struck one in its text": {"stop": SERVO_STOP},
    "a device error that accuses another device": {"error": ended_by(DeviceError("servos", "imu, imu"))},
    "a stop that accuses no device": {"stop": Ended("imu", "not_finite")},
    "a bench that did not open, and a robot that slid": {
        "cycles": 0,
        "error": IMU_STOP,
        "held": NOT_HELD,
        "moved_m": 0.3,
    },
    "a bench that did not open, and a robot that fell": {
        "cycles": 0,
        "error": IMU_STOP,
        "held": NOT_HELD,
        "fallen": True,
    },
    "a bench that did not open, and a robot that slid afterwards": {
        "cycles": 0,
        "error": IMU_STOP,
        "held": NOT_HELD,
        "crept_m": 0.3,
    },
    "an estimate two metres wrong that says one metre": {
        "off_m": np.array([2.0, 0.0]),
        "sigma_m": np.array([1.0, 1.0]),
    },
    "an estimate that is no number": {"off_m": np.full(2, np.nan)},
    "an estimate beyond its sigmas": {"off_m": np.array([0.03, 0.0]), "sigma_m": np.array([5e-3, 5e-3])},
    "a robot that slides after it was said to be held": {"crept_m": 0.002},
    "a robot that falls after it was said to be held": {"fallen": True, "crept_m": 2.0},
    "a robot that moves on after its stop": {"moved_m": 0.006},
    "a robot that is not held": {"held": NOT_HELD},
    "a robot of which nothing is said": {"held": None},
    "a recording that cannot be read": {"unreadable": "torn"},
    "an exception of another kind": {"foreign": "KeyError: 3"},
}


def test_a_good_run_passes():
    assert why() == ""
    assert why(stop=IMU_STOP, events=[]) == ""
    assert why(off_m=np.array([0.015, 0.0]), sigma_m=np.array([5e-3, 5e-3])) == ""


@pytest.mark.parametrize("name", MUTANTS)
def test_every_bad_run_fails(name):
    assert why(**MUTANTS[name])


@pytest.mark.parametrize(
    ("device", "fault", "given"),
    [
        ("adhesion", "off", {"adhesion_n": 3.0}),
        ("plant", "adhesion_loss", {"adhesion_n": 3.0}),
        ("thrust", "garbage", {"thrust_n": 3.0}),
    ],
)
def test_a_fall_is_excused_by_what_was_struck_only_and_never_where_it_was_said_to_be_held(
    device, fault, given
):
    struck = cell(device, fault)
    assert why(struck, **FELL, **given) == ""
    assert "fell" in why(struck, **FELL)
    assert "said to be held" in why(struck, **{**FELL, **given, "held": held()})
    assert "fell" in why(cell("load_cells", "wrong"), **FELL, **given)
    assert "said to be held" in why(struck, **given, crept_m=0.05)


def test_without_torque_a_robot_may_slide_as_fast_as_physics_makes_it_and_until_the_servos_are_back():
    away = {"held": NOT_HELD, "events": [("servos",)]}
    lasting, second = cell("servos", "off"), cell("servos", "off", "second")
    assert why(lasting, **away, moved_m=LIMP_M_S * (LOOKED_S - STOPPED_S)) == ""
    assert "moved by" in why(lasting, **away, moved_m=0.2)
    assert "not held" in why(second, **away)
    assert why(second, events=[("servos",)], moved_m=0.02) == ""
    assert "moved by" in why(second, events=[("servos",)], moved_m=0.05)
    assert "moved by" in why(cell("servo.drive_FL", "off"), **away, moved_m=0.006)
    assert "not held" in why(cell("servos", "jump"), **away)
    assert farthest_m(second, STOPPED_S, 100.0) == farthest_m(second, STOPPED_S, 3.0)
    assert farthest_m(cell("imu", "off"), STOPPED_S, LOOKED_S) == 0.005


def test_a_servo_that_goes_on_to_fail_may_sag_a_little():
    reported = {"events": [("servos",)]}
    lasting = cell("servo.steer_BL", "intermittent")
    assert why(cell("servo.steer_BL", "intermittent", "second"), crept_m=0.003, **reported)
    assert why(lasting, crept_m=0.003, **reported) == ""
    assert why(lasting, crept_m=0.006, **reported)


@pytest.mark.parametrize(
    ("devices", "until", "excused"),
    [
        (("adhesion", "load_cells"), ("", ""), True),
        (("adhesion", "load_cells"), ("", "+1.5"), False),
        (("tracker", "mocap"), ("", ""), True),
        (("tracker", "mocap"), ("+0.5", ""), True),
        (("tracker", "mocap"), ("+0.5", "+0.5"), False),
        (("imu", "mocap"), ("", ""), False),
    ],
)
def test_a_robot_that_no_sensor_sees_need_not_be_called_held(devices, until, excused):
    specs = tuple(f"{name}:garbage@1{end}" for name, end in zip(devices, until, strict=True))
    both = Cell("+".join(devices), "garbage+garbage", "random", 0, "own", specs)
    assert (why(both, held=NOT_HELD, events=[(name,) for name in devices]) == "") is excused


def test_of_several_faults_the_stop_need_not_accuse_the_one_that_did_nothing():
    both = Cell("servos+imu", "stuck+slow", "random", 0, "own", ("servos:stuck@1", "imu:slow@2"))
    verdict = judge(both, seen(stop=SERVO_STOP, events=[]))
    assert (verdict.why, verdict.reported) == ((), False)


def test_who_is_accused_without_being_struck_is_shown():
    verdict = judge(cell(), seen(events=[("imu",), ("servos", "imu"), ("mocap",), ("supervisor",)]))
    assert (verdict.why, verdict.reported, verdict.others) == ((), True, ("mocap",))


def test_whom_an_error_accuses_is_read_from_its_data():
    assert ended_by(SafetyStop("stale_load_cells", "the imu")).suspects == ("load_cells",)
    slides = SafetyStop("sensors_disagree", "x", ("servos", "thrust"))
    assert ended_by(slides).suspects == ("servos", "thrust")
    assert ended_by(DeviceError("tracker", "the imu")).suspects == ("tracker",)


def page(*verdicts):
    return matrix_page(summary(verdicts, bench="emulated", command="hil faults", planned=len(verdicts)))


def test_what_stands_in_a_row_is_what_was_measured_of_it():
    struck = cell("thrust", "garbage")
    good = CellVerdict(struck, (), "went on", False, "HELD", measured=Measured(0.0012, 0.005, 0.0003))
    fell = replace(good, held="NOT HELD", measured=Measured(5.0, 0.005, 9.0, fell=True))
    row = next(line for line in page(good, fell).splitlines() if line.startswith("| `thrust` | `garbage`"))
    assert "fell in 1 of 2; HELD in 1 of 2" in row
    closed = replace(good, held="NOT HELD", opened=False)
    assert "NOT HELD" not in page(good, closed), "nothing was promised of a bench that did not open"
