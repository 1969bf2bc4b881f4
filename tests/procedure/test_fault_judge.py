"""The judge of the fault campaign, judged itself: made-up runs, good ones and bad ones of every kind."""

from dataclasses import replace

import numpy as np
import pytest

from hil.bench import Held
from hil.core.errors import ConfigError, DeviceError, SafetyStop
from hil.core.signals import SERVOS
from hil.fault_matrix import MOMENTS, Cell, CellVerdict, matrix_page, summary
from hil.fault_matrix.judge import Measured, judge
from hil.fault_matrix.movement_bounds import LIMP_M_S, farthest_m
from hil.fault_matrix.observation import Ended, Figures, Seen, Told, ended_by

STOPPED_S, LOOKED_S = 1.4, 6.4


def cell(device="imu", fault="wrong", moment="motion"):
    return Cell(device, fault, moment, 0, "own", (f"{device}:{fault}{MOMENTS[moment]}",))


def held(state="HELD", why="torque on"):
    return Held(state, 0.0, why)


def seen(**given):
    good = {"cycles": 300, "held": held(), "events": [told("imu")], "figures": Figures(0.001, 0.001)}
    return Seen(**{**good, "stopped_s": STOPPED_S, "looked_s": LOOKED_S, **given})


def told(*names, text=""):
    return Told(names, text)


def why(struck=None, **given):
    return "; ".join(judge(cell() if struck is None else struck, seen(**given)).why)


IMU_STOP = Ended("SafetyStop: robot stopped (stale_imu): silent", "stale_imu", ("imu",))
SERVO_STOP = Ended("SafetyStop: robot stopped (blocked): at the maximum of its imu", "blocked", ("servos",))
NOT_HELD = held("NOT HELD", "it slides")
SHUT = {"cycles": 0, "error": IMU_STOP, "held": NOT_HELD, "figures": None}
EVERY = ("adhesion", "encoders", "imu", "load_cells", "mocap", "servos", "thrust", "tracker")
FELL = {"fallen": True, "held": NOT_HELD, "moved_m": 1.0, "crept_m": 9.0}

MUTANTS = {
    "a fall while another device than the struck one let go": {**FELL, "adhesion_n": 3.0},
    "a fall while propellers let go that were not struck": {**FELL, "thrust_n": 3.0},
    "a fall that nothing explains": FELL,
    "a fall of a robot that need not be held": {**FELL, "held": held("not needed")},
    "a fall before anything was driven": {"cycles": 0, "error": IMU_STOP, "held": None, "fallen": True},
    "a fall of which the bench says nothing": {**FELL, "held": None},
    "a stop that accuses another device, with the noun of the struck one in its text": {"stop": SERVO_STOP},
    "a device error that accuses another device": {"error": ended_by(DeviceError("servos", "imu, imu"))},
    "a stop that accuses no device": {"stop": Ended("imu", "not_finite")},
    "a stop that accuses every device": {"stop": Ended("x", "sensors_disagree", EVERY)},
    "a stop that accuses all but one": {"stop": Ended("x", "sensors_disagree", EVERY[:-1])},
    "a stop that accuses only the supervisor": {"stop": Ended("x", "adhesion", ("supervisor",))},
    "an error in use that ends the drive": {"stop": Ended("UsageError: factor", "UsageError")},
    "a second error that accuses another device": {"stop": IMU_STOP, "error": SERVO_STOP},
    "a bench that did not open, and a robot that slid": {**SHUT, "moved_m": 0.3},
    "a bench that did not open, and a robot that fell": {**SHUT, "fallen": True},
    "a bench that did not open, and a robot that slid afterwards": {**SHUT, "crept_m": 0.3},
    "an estimate two metres wrong that says one metre": {
        "off_m": np.array([2.0, 0.0]),
        "sigma_m": np.array([1.0, 1.0]),
    },
    "an estimate that is no number": {"off_m": np.full(2, np.nan)},
    "an estimate beyond its sigmas": {"off_m": np.array([0.03, 0.0]), "sigma_m": np.array([5e-3, 5e-3])},
    "a robot that slides after it was said to be held": {"crept_m": 0.002},
    "a robot that falls after it was said to be held": {"fallen": True, "crept_m": 2.0},
    "a robot that is held by a fan that has almost stopped": {"left_adhesion_n": 15.0},
    "a robot that is held by a force that is no number": {"left_adhesion_n": np.nan},
    "a robot that moves on after its stop": {"moved_m": 0.006},
    "a motion after the stop that is no number": {"moved_m": np.nan},
    "a robot that is not held": {"held": NOT_HELD},
    "a robot that is not held and slides 400 mm": {"held": NOT_HELD, "crept_m": 0.4, "stop": IMU_STOP},
    "a robot that need not be held on a wall, and stays": {"held": held("not needed")},
    "a robot that need not be held on a wall, and slides": {"held": held("not needed"), "crept_m": 1.0},
    "a robot of which nothing is said": {"held": None},
    "a drive 60 mm off its reference that knows it": {"astray_m": 0.06},
    "a drive 25 mm off its reference, stopped in the end": {"astray_m": 0.025, "stop": IMU_STOP},
    "a drive that was nowhere": {"astray_m": np.nan},
    "a drive that passes by its own figure and is 60 mm off": {"figures": Figures(0.002, 0.06)},
    "a drive that passes by a marked figure and is 12 mm off": {"figures": Figures(0.002, 0.012, True)},
    "a drive that fails by a sensor that is wrong, unmarked": {"figures": Figures(0.1, 0.001)},
    "a drive that was not measured, and does not say why": {
        "figures": Figures(np.nan, 0.001),
        "events": [told("supervisor")],
    },
    "a drive whose true end is no number": {"figures": Figures(0.001, np.nan)},
    "a drive off its way of which nobody is told": {"events": [], "effect_m": 0.004},
    "a drive off its way of which only another device is told": {
        "events": [told("mocap"), told("supervisor")],
        "effect_m": 0.004,
    },
    "a fan that has sagged and nobody is told": {"events": [], "adhesion_n": 25.0},
    "propellers that have sagged and nobody is told": {"events": [told("tracker")], "thrust_n": 12.0},
    "an effect that is no number": {"events": [], "effect_m": np.nan},
    "a recording that cannot be read": {"unreadable": "torn"},
    "an exception of another kind": {"foreign": "KeyError: 3"},
}


def test_a_good_run_passes():
    assert why() == ""
    assert why(stop=IMU_STOP, events=[], figures=None) == ""
    assert why(events=[], effect_m=0.001) == "", "a fault without effect need not be told"
    assert why(figures=Figures(0.1, 0.001, marked=True)) == ""
    assert why(figures=Figures(np.nan, 0.001, marked=True)) == ""
    assert (
        why(on_wall=False, held=held("not needed"), adhesion_n=0.0, thrust_n=0.0, left_adhesion_n=0.0) == ""
    )
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
    struck, given = cell(device, fault), {**given, "events": [told(device, "adhesion")]}
    assert why(struck, **FELL, **given) == ""
    assert "fell" in why(struck, **FELL)
    assert "went on" in why(struck, **{**given, "events": []})
    assert "said to be held" in why(struck, **{**FELL, **given, "held": held()})
    assert "fell" in why(cell("load_cells", "wrong"), **FELL, **given)
    assert "said to be held" in why(struck, **given, crept_m=0.05)


def test_without_torque_a_robot_may_slide_as_fast_as_physics_makes_it_and_until_the_servos_are_back():
    away = {"held": NOT_HELD, "events": [told("servos")]}
    lasting, second = cell("servos", "off"), cell("servos", "off", "second")
    assert why(lasting, **away, moved_m=LIMP_M_S * (LOOKED_S - STOPPED_S)) == ""
    assert "moved by" in why(lasting, **away, moved_m=0.2)
    assert "not held" in why(second, **away)
    assert why(second, events=[told("servos")], moved_m=0.02) == ""
    assert "moved by" in why(second, events=[told("servos")], moved_m=0.05)
    one = {"held": held("NOT HELD", "drive_FL (ID 1, timeout)"), "events": [told("servos")]}
    assert "moved by" in why(cell("servo.drive_FL", "off"), **one, moved_m=0.006)
    assert "not held" in why(cell("servos", "jump"), **away)
    assert farthest_m(second, STOPPED_S, 100.0) == farthest_m(second, STOPPED_S, 3.0)
    assert farthest_m(cell("imu", "off"), STOPPED_S, LOOKED_S) == 0.005


def test_a_servo_that_goes_on_to_fail_may_sag_a_little():
    reported = {"events": [told("servos")]}
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
    assert (why(both, held=NOT_HELD, events=[told(name) for name in devices]) == "") is excused


FALLS = {"adhesion": {"adhesion_n": 8.0}, "thrust": {"thrust_n": 3.0}}


@pytest.mark.parametrize("said", [None, "HELD", "NOT HELD", "not needed"])
@pytest.mark.parametrize(
    ("device", "fault"),
    [(d, f) for d in FALLS for f in ("wrong", "jump", "delayed", "stuck", "duplicate")]
    + [("adhesion", "slow")],
)
def test_what_the_bench_does_on_a_wrong_report_excuses_no_fall(device, fault, said):
    left = {**FELL, **FALLS[device], "held": said and held(said), "events": [told(device)]}
    assert "the robot fell" in why(cell(device, fault), **left)
    several = Cell(f"{device}+imu", f"{fault}+off", "random", 0, "own", (f"{device}:{fault}@1", "imu:off@1"))
    assert "the robot fell" in why(several, **left)


@pytest.mark.parametrize(
    ("spec", "excused"),
    [
        ("thrust:unplug@1", True),
        ("thrust:silent@1", False),
        ("thrust:silent@1,direction=out", True),
        ("thrust:unplug@1,direction=in", False),
    ],
)
def test_a_wire_that_carries_commands_is_no_excuse(spec, excused):
    device, _, rest = spec.partition(":")
    struck = Cell(device, rest.partition("@")[0], "motion", 0, "own", (spec,))
    assert ("the robot fell" not in why(struck, **FELL, thrust_n=3.0)) is excused


@pytest.mark.parametrize("thrust_n", [9.0, 12.0])
def test_propellers_that_still_push_are_no_excuse_since_the_fan_can_press_harder(thrust_n):
    assert "the robot fell" in why(cell("thrust", "garbage"), **FELL, thrust_n=thrust_n)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("steer_FL (ID 5, timeout)", True),
        ("wheel FL is asked for 3.7 rad/s and does not turn", False),
        ("no servo answers: check supply, bus, adapter", False),
        ("steer_BL (ID 6, timeout)", False),
        (", ".join(SERVOS), False),
    ],
)
def test_of_eight_servos_the_faulty_one_is_named(text, named):
    stop = Ended(text, "stale_servos", ("servos",))
    assert (why(cell("servo.steer_FL", "garbage", "second"), stop=stop, figures=None) == "") is named
    assert (why(cell("servo.5", "garbage", "second"), stop=stop, figures=None) == "") is named
    lost = {"stop": Ended("steer_FL", "stale_servos", ("servos",)), "figures": None}
    why_lost = why(cell("servo.steer_FL", "off"), held=held("NOT HELD", text), **lost)
    assert ("does not name" in why_lost) is ("steer_FL" not in text)


def test_a_robot_that_is_not_held_moves_no_more_than_its_faults_explain():
    one = {"held": held("NOT HELD", "steer_FL (timeout)"), "events": [told("servos")], "figures": None}
    assert "after the report" in why(cell("servo.steer_FL", "off"), **one, crept_m=0.4)
    assert why(cell("servo.steer_FL", "off"), **one, crept_m=0.004) == ""
    every = {**one, "held": held("NOT HELD", "no servo answers")}
    assert why(cell("servos", "off"), **every, crept_m=0.1) == ""
    assert "after the report" in why(cell("servos", "off"), **every, crept_m=0.4)


def test_of_several_faults_the_stop_need_not_accuse_the_one_that_did_nothing():
    both = Cell("servos+imu", "stuck+slow", "random", 0, "own", ("servos:stuck@1", "imu:slow@2"))
    verdict = judge(both, seen(stop=SERVO_STOP, events=[]))
    assert (verdict.why, verdict.reported) == ((), False)


def test_who_is_accused_without_being_struck_is_shown():
    verdict = judge(
        cell(), seen(events=[told("imu"), told("servos", "imu"), told("mocap"), told("supervisor")])
    )
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


def test_a_bench_file_that_a_faulty_device_contradicts_names_it_by_its_key():
    """A body mistaken for another before the first motion: the bench cannot tell it from a wrong key."""
    refused = ended_by(ConfigError("emulated: either imu.mount_rotation_wxyz or mocap.body is wrong"))
    assert set(refused.suspects) == {"imu", "mocap"}
    assert not why(cell("mocap", "jump", "open"), cycles=0, figures=None, error=refused)
    assert "mocap" in why(cell("encoders", "jump", "open"), cycles=0, figures=None, error=refused)
