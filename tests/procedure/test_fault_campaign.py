"""The fault campaign: which cells there are, what makes one fail, and the short form of it."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from hil.bench import Held, supported_faults
from hil.cli.faults import command
from hil.config.loading import load_bench
from hil.procedure.faults import MOMENTS, Cell, CellVerdict, cells_of, matrix_page, random_cells
from hil.procedure.faults.judging import Seen, judge
from hil.procedure.faults.quiet import why_quiet
from hil.vocabulary.errors import ConfigError, HilError, UsageError

SUPPORTED = {
    "plant": ("adhesion_loss",), "servos": ("off", "jump"), "servo.drive_FL": ("off",),
    "servo.drive_BL": ("off",), "servo.1": ("off",), "encoder.FL": ("stuck",), "encoder.BR": ("stuck",),
    "imu": ("wrong",),
}  # fmt: skip


def cells(**given):
    return cells_of(SUPPORTED, **{"seeds": (0,), "plants": ("own",), **given})


def test_one_of_eight_servos_and_four_encoders_stands_for_the_others():
    found = {(c.device, c.fault) for c in cells()}
    assert found == {
        ("plant", "adhesion_loss"), ("servos", "off"), ("servos", "jump"), ("servo.drive_FL", "off"),
        ("encoder.FL", "stuck"), ("imu", "wrong"),
    }  # fmt: skip
    assert len(cells()) == 6 * len(MOMENTS)
    assert len(cells(seeds=(0, 1), plants=("own", "mujoco"), moments=("open",))) == 6 * 4


def test_every_fault_of_the_shipped_bench_has_its_cells():
    supported = supported_faults(load_bench("emulated"))
    devices = {c.device for c in cells_of(supported, seeds=(0,), plants=("own",))}
    assert devices >= {
        "servos",
        "servo.steer_FL",
        "encoders",
        "imu",
        "tracker",
        "mocap",
        "adhesion",
        "thrust",
    }
    assert devices >= {"load_cells", "plant"}


def test_only_names_devices_faults_and_moments():
    assert {c.moment for c in cells(only=("imu",))} == set(MOMENTS)
    (one,) = cells(only=("servo.drive_BL:off@second",))
    assert one.specs == ("servo.drive_BL:off@1.3+1",)
    for wrong in ("imus", "imu:off", "imu:wrong@later"):
        with pytest.raises(UsageError, match="no such cell"):
            cells(only=(wrong,))


def test_random_runs_are_the_same_for_the_same_arguments():
    first = random_cells(SUPPORTED, count=30, seeds=(1, 2), plants=("own",))
    assert first == random_cells(SUPPORTED, count=30, seeds=(1, 2), plants=("own",))
    assert first != random_cells(SUPPORTED, count=30, seeds=(2, 1), plants=("own",))
    assert {len(c.specs) for c in first} == {1, 2, 3, 4}
    assert not any(c.device.startswith("servo.1") for c in first)


def cell(device="imu", fault="wrong", moment="motion"):
    return Cell(device, fault, moment, 0, "own", (f"{device}:{fault}{MOMENTS[moment]}",))


def seen(**given):
    return Seen(**{"cycles": 300, "said": "HELD", "events": [("imu", "it is wrong")], **given})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, ""),
        ({"said": "NOT HELD", "why": "torque"}, "not held: torque"),
        ({"crept_m": 0.002}, "said to be held, and moved by 2.0 mm"),
        ({"moved_m": 0.006}, "moved by 6.0 mm after the stop"),
        ({"fallen": True}, "fell although fan"),
        ({"fallen": True, "said": "NOT HELD", "adhesion_n": 3.0, "moved_m": 1.0}, ""),
        ({"fallen": True, "said": "NOT HELD", "thrust_n": 12.0, "moved_m": 1.0}, ""),
        ({"stop": "SafetyStop: robot stopped (blocked): wheel FL", "events": []}, "is not named"),
        ({"stop": "SafetyStop: robot stopped (x): the IMU is mad", "events": []}, ""),
        (
            {"stop": "SafetyStop: robot stopped (x)", "events": [], "why": "at rest by IMU"},
            "is not named",
        ),
        ({"unreadable": "torn"}, "the recording: torn"),
        ({"foreign": "KeyError: 3"}, "an exception of another kind: KeyError: 3"),
        ({"off_m": np.array([0.03, 0.0]), "sigma_m": np.array([0.005, 0.005])}, "30 mm beside its estimate"),
        (
            {"off_m": np.array([0.03, 0.0]), "said": "NOT HELD", "thrust_n": 12.0, "fallen": True},
            "",
        ),
        ({"off_m": np.array([0.015, 0.0]), "sigma_m": np.array([0.005, 0.005])}, ""),
    ],
)
def test_what_makes_a_cell_fail(given, said):
    why = judge(cell(), seen(**given)).why
    assert "; ".join(why).count(said) == (1 if said else 0) or not said
    assert bool(why) is bool(said)
    assert all(said in text for text in why)


def test_servos_without_supply_to_the_end_cannot_be_held_but_those_that_come_back_must():
    away = {"said": "NOT HELD", "why": "drive_FL (timeout)", "events": [("servos", "gone")], "moved_m": 0.02}
    assert judge(cell("servos", "off", "motion"), seen(**away)).why == ()
    (why,) = judge(cell("servos", "off", "second"), seen(**away)).why
    assert why.startswith("not held")
    assert judge(cell("servos", "jump", "motion"), seen(**away)).why != ()


def pressed_by(cells_at, **given):
    lying = ("adhesion:garbage@1.0", f"load_cells:garbage@{cells_at}")
    both = Cell("adhesion+load_cells", "garbage+garbage", "random", 0, "own", lying)
    told = [("adhesion", "it is mad"), ("load_cells", "they are mad")]
    return judge(
        both, seen(said="NOT HELD", why="what presses the robot on the wall", events=told, **given)
    ).why


def test_a_robot_whose_force_nobody_measures_need_not_be_called_held():
    assert pressed_by("2.0") == ()
    (why,) = pressed_by("2.0+1.5")  # the load cells tell the truth again
    assert why.startswith("not held")
    (why,) = pressed_by("2.0", crept_m=0.0, moved_m=0.006)
    assert why.startswith("moved by")
    (why,) = judge(cell("adhesion", "garbage"), seen(said="NOT HELD", why="force")).why
    assert why.startswith("not held")


def test_a_servo_that_goes_on_to_fail_behind_the_look_may_sag_a_little():
    told = {"events": [("servos", "gone")]}
    assert judge(cell("servo.steer_BL", "intermittent", "second"), seen(crept_m=0.003, **told)).why != ()
    lasting = Cell("servo.steer_BL", "intermittent", "random", 6, "own", ("servo.steer_BL:intermittent@0.3",))
    assert judge(lasting, seen(crept_m=0.003, **told)).why == ()
    assert judge(lasting, seen(crept_m=0.006, **told)).why != ()


@pytest.mark.parametrize(
    ("until", "excused"), [(("", ""), True), (("+0.5", ""), True), (("+0.5", "+0.5"), False)]
)
def test_a_robot_that_nobody_sees_need_not_be_called_held(until, excused):
    """Whether its propellers still carry it is told by those who see a slide only."""
    specs = tuple(f"{name}:off@1{until}" for name, until in zip(("tracker", "mocap"), until, strict=True))
    blind = Cell("tracker+mocap", "off+off", "random", 0, "own", specs)
    told = [("tracker", "it is away"), ("mocap", "it is away")]
    why = judge(blind, seen(said="NOT HELD", why="nobody sees whether it slides", events=told)).why
    assert (why == ()) is excused


def test_what_holds_the_robot_may_go_after_it_was_said_to_be_held_if_that_is_noticed():
    gone = {"crept_m": 0.01, "adhesion_n": 9.0}
    noticed, still = Held("NOT HELD", 0.5, "adhesion is lost", True), Held("HELD", 0.0, "torque on", True)
    assert judge(cell(), seen(**gone, held=noticed)).why == ()
    (why,) = judge(cell(), seen(**gone, held=still)).why
    assert why.startswith("said to be held")
    assert judge(cell(), seen(crept_m=0.01, held=noticed)).why != ()


def test_of_several_faults_the_stop_need_not_name_the_one_that_did_nothing():
    both = Cell("servos+imu", "off+slow", "random", 0, "own", ("servos:off@1", "imu:slow@2"))
    stop = "SafetyStop: robot stopped (stale_servos): no complete servo read"
    verdict = judge(both, seen(stop=stop, events=[]))
    assert (verdict.why, verdict.told) == ((), False)
    (why,) = judge(both, seen(stop="SafetyStop: robot stopped (x): the fan is mad", events=[])).why
    assert why.startswith("the device is not named")


def test_a_run_that_goes_on_without_a_word_about_the_device_is_marked():
    quiet = judge(cell(), seen(events=[], why="torque on, at rest by servo positions, IMU, camera"))
    assert (quiet.why, quiet.told, quiet.ended) == ((), False, "went on")
    stopped = judge(
        cell("servos", "jump"), seen(events=[("servos", "a leap")], stop="robot stopped (servo_jump)")
    )
    assert (stopped.told, stopped.ended) == (True, "servo_jump")
    fell = CellVerdict(cell("mocap", "off"), ("it | fell",), "went on", True, "HELD")
    page = matrix_page([quiet, stopped, fell], "hil faults")
    assert "| `imu` | `wrong` | on * |" in page
    assert "| `servos` | `jump` | stop |" in page
    assert "| `mocap` | `off` | **FAILED** 1/1 |" in page
    assert "| `mocap:off motion seed 0 own` | it / fell |" in page
    assert "3 cells, 1 failed, 1 passed without a word" in page
    assert "| `imu` | `wrong` | motion | nobody notices |" in page
    assert "Without a word" not in matrix_page([stopped, fell], "hil faults")


@pytest.mark.parametrize(
    ("device", "fault", "why"),
    [
        ("encoder.FL", "corrupt", "refused by their check"), ("thrust", "stuck", "sends nothing back"),
        ("mocap", "slow", "longer run"), ("imu", "slow", "nobody notices"),
        ("servo.steer_FL", "slow", "within their time"), ("tracker", "wrong", "nobody notices"),
    ],
)  # fmt: skip
def test_of_every_silence_the_page_says_why(device, fault, why):
    assert why in why_quiet(device, fault)
    assert "the run was over" in why_quiet(device, fault, ["stop"])


def run(*arguments):
    return CliRunner().invoke(command, arguments, standalone_mode=False)


def test_the_short_form_passes(tmp_path):
    result = run("--quick", "--json", "--out", str(tmp_path / "new" / "folder"))
    told = json.loads(result.stdout)
    assert result.return_value == 0, told["failed"]
    assert (told["cells"], told["failed"]) == (5, [])
    assert "| `servos` | `brownout` |" in (tmp_path / "new" / "folder" / "reliability.md").read_text(
        encoding="utf-8"
    )


def test_physics_that_are_not_installed_are_refused_before_the_first_cell(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.fakes.mujoco_plant.reading.lacks", lambda extra: "not installed")
    with pytest.raises(ConfigError, match="needs the extra mujoco"):
        command.main(["--plants", "own,mujoco", "--out", str(tmp_path / "out")], standalone_mode=False)
    assert not (tmp_path / "out").exists()


def test_a_failed_cell_is_told_with_its_reason_and_is_exit_code_1(tmp_path, monkeypatch):
    def fallen(cell, bench):
        return CellVerdict(cell, ("it fell",), "went on", True, "HELD")

    monkeypatch.setattr("hil.procedure.faults.run_cell", fallen)
    result = run("--only", "imu:wrong@open", "--json", "--out", str(tmp_path))
    (failed,) = json.loads(result.stdout)["failed"]
    assert result.return_value == 1
    assert (failed["device"], failed["fault"], failed["moment"], failed["why"]) == (
        "imu",
        "wrong",
        "open",
        "it fell",
    )
    assert "FAILED imu:wrong open" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--plants", "moon"), "moon"), (("--moments", "later"), "later"), (("--only", "imu:of"), "imu:off"),
        (("--quick", "--random", "3"), "exclude"), (("--seeds", "x"), "--seeds"),
        (("--bench", "sensors"), "cannot be real"),
    ],
)  # fmt: skip
def test_what_there_is_not_is_refused_before_anything_runs(arguments, named):
    with pytest.raises(HilError, match=named) as refused:
        command.main([*arguments], standalone_mode=False)
    assert refused.value.exit_code == 2


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("plant", ["own", "mujoco"])
def test_every_cell_passes(tmp_path, plant):
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    result = run("--seeds", "0:5", "--plants", plant, "--json", "--out", str(tmp_path))
    assert json.loads(result.stdout)["failed"] == []


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_nobody_falls_in_random_runs(tmp_path):
    result = run("--random", "200", "--seeds", "0:10", "--json", "--out", str(tmp_path))
    assert json.loads(result.stdout)["failed"] == []


@pytest.fixture
def judged(monkeypatch):
    """Cells that are judged without driving; the list of those that were asked for."""
    asked = []

    def verdict(cell, bench):
        asked.append(cell)
        return CellVerdict(cell, (), "went on", True, "HELD")

    monkeypatch.setattr("hil.procedure.faults.run_cell", verdict)
    return asked


def test_a_campaign_goes_on_with_what_is_missing_and_writes_one_page(tmp_path, judged):
    run("--only", "imu:off", "--moments", "open,motion", "--out", str(tmp_path))
    kept = tmp_path / "cells.jsonl"
    whole = kept.read_text(encoding="utf-8")
    kept.write_text(whole[:-20], encoding="utf-8")
    first = list(judged)
    judged.clear()
    result = run("--only", "imu:off", "--seeds", "0:2", "--out", str(tmp_path), "--resume")
    assert result.return_value == 0
    assert len(judged) == 7
    assert judged[0] == first[1]
    assert "8 cells, 0 failed" in (tmp_path / "reliability.md").read_text(encoding="utf-8")
    assert kept.read_text(encoding="utf-8").count("\n") == 9
    judged.clear()
    run("--only", "imu:off", "--out", str(tmp_path))
    assert len(judged) == 4
    assert (tmp_path / "cells.before.jsonl").read_text(encoding="utf-8").count("\n") == 9


@pytest.mark.parametrize(
    ("spoilt", "named"),
    [
        (lambda text: text.replace("emulated", "other"), "another bench"),
        (lambda text: text.replace('"why": []', '"why": 1'), ":2: is no verdict"),
        (lambda text: text.replace('"seed"', '"sed"'), ":2: is no verdict"),
        (lambda text: "x\n" + text, "is no verdict"),
    ],
)
def test_verdicts_of_something_else_are_refused(tmp_path, judged, spoilt, named):
    run("--only", "imu:off@open", "--out", str(tmp_path))
    kept = tmp_path / "cells.jsonl"
    kept.write_text(spoilt(kept.read_text(encoding="utf-8")), encoding="utf-8")
    judged.clear()
    with pytest.raises(HilError, match=named) as refused:
        command.main(["--only", "imu:off", "--out", str(tmp_path), "--resume"], standalone_mode=False)
    assert refused.value.exit_code == 2
    assert judged == []


def test_there_must_be_something_to_resume(tmp_path):
    with pytest.raises(HilError, match="no campaign to resume"):
        command.main(["--quick", "--out", str(tmp_path), "--resume"], standalone_mode=False)
