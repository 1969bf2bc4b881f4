"""The fault campaign: which cells there are, what makes one fail, and the short form of it."""

import json
import os
import signal

import pytest
from click.testing import CliRunner

from hil import fault_matrix as faults
from hil.bench import check_faults, supported_faults
from hil.cli.faults import command
from hil.config.loading import load_bench
from hil.core.errors import Aborted, ConfigError, HilError, UsageError
from hil.fault_matrix import MOMENTS, Cell, CellVerdict, cells_of, quick_cells, random_cells
from hil.faults.files import read_faults
from hil.report.history.index import find_results
from hil.robot.trajectories import line
from hil.support.folder_lock import locked

SUPPORTED = {
    device: dict.fromkeys(faults, ())
    for device, faults in {
        "plant": ("adhesion_loss",),
        "servos": ("off", "jump"),
        "servo.drive_FL": ("off",),
        "servo.drive_BL": ("off",),
        "servo.1": ("off",),
        "encoder.FL": ("stuck",),
        "encoder.BR": ("stuck",),
        "imu": ("wrong",),
    }.items()
}


def cells(**given):
    return cells_of(SUPPORTED, **{"seeds": (0,), "plants": ("own",), **given})


def test_one_of_eight_servos_and_four_encoders_stands_for_the_others():
    found = {(c.device, c.fault) for c in cells()}
    assert found == {
        ("plant", "adhesion_loss"),
        ("servos", "off"),
        ("servos", "jump"),
        ("servo.drive_FL", "off"),
        ("encoder.FL", "stuck"),
        ("imu", "wrong"),
    }
    assert len(cells()) == 6 * len(MOMENTS)
    assert len(cells(seeds=(0, 1), plants=("own", "mujoco"), moments=("open",))) == 6 * 4


def test_every_fault_of_the_shipped_bench_has_its_cells():
    supported = supported_faults(load_bench("emulated"))
    devices = {c.device for c in cells_of(supported, seeds=(0,), plants=("own",))}
    assert devices >= {*load_bench("emulated").devices(), "servo.steer_FL", "plant"}


@pytest.mark.parametrize("factor", [-1, -10])
def test_a_force_that_no_propeller_has_is_refused_before_the_run(factor):
    """It once raised out of the emulator in mid-drive, and nobody looked whether the robot is held."""
    with pytest.raises(UsageError, match=r"factor is -10?; expected a number from 0 to 10"):
        check_faults(load_bench("emulated"), read_faults([f"thrust:wrong@2,factor={factor}"]))


def test_a_wire_that_fails_in_one_direction_lets_the_robot_move_no_further_than_in_both():
    """Replies are lost, commands still arrive: the watchdogs of the servos do not trip."""
    moved_mm = {}
    for way in ("in", "both"):
        spec = f"servos:silent@1.3+1,direction={way}"
        verdict = faults.run_cell(Cell("servos", "silent", "random", 7, "own", (spec,)))
        assert not verdict.why
        moved_mm[way] = 1e3 * verdict.measured.moved_m
    assert moved_mm["in"] <= moved_mm["both"] <= 2.5


def test_faults_are_tried_at_strengths_of_both_signs_that_their_devices_take():
    bench = load_bench("emulated")
    found = cells_of(supported_faults(bench), seeds=(0,), plants=("own",))
    check_faults(bench, read_faults(spec for cell in found for spec in cell.specs))
    assert len(found) == len({cell.name for cell in found})
    for device, fault in (("imu", "wrong"), ("tracker", "jump"), ("adhesion", "jump"), ("servos", "wrong")):
        numbers = [
            float(c.strength.split("=")[1])
            for c in found
            if (c.device, c.fault) == (device, fault) and c.strength
        ]
        assert min(numbers) < 0 < max(numbers)
        assert max(numbers) > 10 * min(map(abs, numbers))
    ways = {c.strength for c in found if (c.device, c.fault) == ("servos", "silent")}
    assert ways == {"", "direction=out", "direction=both"}
    assert ("thrust", "duplicate") not in {(c.device, c.fault) for c in found}


def test_only_names_devices_faults_and_moments():
    assert {c.moment for c in cells(only=("imu",))} == set(MOMENTS)
    (one,) = cells(only=("servo.drive_BL:off@second",))
    assert one.specs == ("servo.drive_BL:off@1.3+1",)
    for wrong in ("imus", "imu:off", "imu:wrong@later"):
        with pytest.raises(UsageError, match="no such cell"):
            cells(only=(wrong,))
    with pytest.raises(UsageError, match="no such cell"):
        cells(only=("imu:wrong@motion",), moments=("stop",))


def test_random_runs_are_the_same_for_the_same_arguments():
    first = random_cells(SUPPORTED, count=30, seeds=(1, 2), plants=("own",))
    assert first == random_cells(SUPPORTED, count=30, seeds=(1, 2), plants=("own",))
    assert first != random_cells(SUPPORTED, count=30, seeds=(2, 1), plants=("own",))
    assert {len(c.specs) for c in first} == {1, 2, 3, 4}
    assert not any(c.device.startswith("servo.1") for c in first)


def run(*arguments):
    return CliRunner().invoke(command, arguments, standalone_mode=False)


def test_the_short_form_passes(tmp_path):
    result = run("--quick", "--json", "--out", str(tmp_path / "new" / "folder"))
    reported = json.loads(result.stdout)
    assert result.return_value == 0, reported["failed"]
    assert (reported["cells"], reported["failed"]) == (8, [])
    folder = tmp_path / "new" / "folder"
    assert "| `servos` | `brownout` |" in (folder / "reliability.md").read_text(encoding="utf-8")
    assert reported["page"] == str(folder / "faults.html")
    assert "brownout" in (folder / "faults.html").read_text(encoding="utf-8")


def test_the_short_form_of_a_bench_without_a_fan_leaves_out_the_fan():
    """Its last cell once ended the whole campaign: "no emulated device of that name"."""
    have = supported_faults(load_bench("emulated_floor"))
    found = quick_cells(have, seeds=(0,), plants=("own",))
    assert {cell.device for cell in found} == {"servos", "servo.steer_FL", "tracker", "imu", "plant"}


def test_physics_that_are_not_installed_are_refused_before_the_first_cell(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.fakes.plant.mujoco.mjcf.why_unusable", lambda extra: "not installed")
    with pytest.raises(ConfigError, match="needs the extra mujoco"):
        command.main(["--plants", "own,mujoco", "--out", str(tmp_path / "out")], standalone_mode=False)
    assert not (tmp_path / "out").exists()


def test_a_failed_cell_is_reported_with_its_reason_and_is_exit_code_1(tmp_path, monkeypatch):
    def fallen(cell, bench):
        return CellVerdict(cell, ("it fell",), "went on", True, "HELD")

    monkeypatch.setattr("hil.fault_matrix.run_cell", fallen)
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
        (("--plants", "moon"), "moon"),
        (("--only", "imu:of"), "imu:off"),
        (("--quick", "--random", "3"), "exclude"),
        (("--bench", "sensors"), "cannot be real"),
    ],
)
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
def test_no_robot_falls_in_random_runs(tmp_path):
    result = run("--random", "200", "--seeds", "0:10", "--json", "--out", str(tmp_path))
    assert json.loads(result.stdout)["failed"] == []


@pytest.fixture
def judged(monkeypatch):
    """Cells that are judged without driving; the list of those that were asked for."""
    asked = []

    def verdict(cell, bench):
        asked.append(cell)
        return CellVerdict(cell, (), "went on", True, "HELD")

    monkeypatch.setattr("hil.fault_matrix.run_cell", verdict)
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


def test_one_that_is_at_work_is_left_alone(tmp_path, judged):
    before = ["--only", "imu:off", "--out", str(tmp_path)]
    assert run(*before).return_value == 0
    cells = (tmp_path / "cells.jsonl").read_bytes()
    with locked(tmp_path, "a fault campaign"):
        for more in ((), ("--resume",)):
            with pytest.raises(UsageError, match="a fault campaign is at work there"):
                command.main([*before, *more], standalone_mode=False)
    assert (tmp_path / "cells.jsonl").read_bytes() == cells


def test_one_that_is_interrupted_shows_what_it_has_judged(tmp_path, judged, monkeypatch, capsys):
    ordinary = faults.run_cell

    def verdict(cell, bench):
        if len(judged) == 2:
            raise KeyboardInterrupt
        return ordinary(cell, bench)

    monkeypatch.setattr(faults, "run_cell", verdict)
    with pytest.raises(Aborted, match="2 of 4 cells are judged"):
        command.main(["--only", "imu:off", "--out", str(tmp_path)], standalone_mode=False)
    assert str(tmp_path / "faults.html") in capsys.readouterr().err
    for page in ("faults.html", "reliability.md"):
        assert "Ended early" in (tmp_path / page).read_text(encoding="utf-8")
    reported = json.loads((tmp_path / "faults.json").read_text(encoding="utf-8"))
    assert (reported["verdict"], reported["cells"], reported["planned"]) == ("ABORTED", 2, 4)
    (kept,) = find_results(tmp_path)
    assert (kept.kind, kept.verdict) == ("faults", "ABORTED")
    judged.clear()
    assert run("--only", "imu:off", "--out", str(tmp_path), "--resume").return_value == 0
    assert len(judged) == 2
    assert "Ended early" not in (tmp_path / "faults.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("spoilt", "named"),
    [
        (lambda text: text.replace("emulated", "other"), "another bench"),
        (lambda text: text.replace('"why": []', '"why": 1'), ":2: is no verdict"),
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


def test_sigterm_within_a_run_ends_the_campaign_at_once(tmp_path, monkeypatch):
    begun = []

    def struck(*given, **options):
        begun.append(given)
        os.kill(os.getpid(), signal.SIGTERM)
        return line(*given, **options)

    monkeypatch.setattr("hil.fault_matrix.drive.line", struck)
    with pytest.raises(Aborted, match="SIGTERM; 0 of 2 cells are judged"):
        command.main(
            ["--only", "imu:off", "--moments", "motion,stop", "--out", str(tmp_path)], standalone_mode=False
        )
    assert len(begun) == 1


@pytest.mark.parametrize(("spec", "seed"), [("servos:duplicate@2.85", 1), ("imu:corrupt@0.05", 0)])
def test_messages_spoilt_now_and_then_leave_the_robot_held(spec, seed):
    device, fault = spec.split("@")[0].split(":")
    verdict = faults.run_cell(Cell(device, fault, "random", seed, "own", (spec,)))
    assert not verdict.why
    assert verdict.held == "HELD"


def test_it_does_not_resume_what_another_command_began_or_none(tmp_path, judged):
    with pytest.raises(HilError, match="no campaign to resume"):
        command.main(["--quick", "--out", str(tmp_path), "--resume"], standalone_mode=False)
    run("--only", "imu:off", "--out", str(tmp_path))
    with pytest.raises(UsageError, match="options of the command that began there"):
        command.main(["--only", "imu:wrong", "--out", str(tmp_path), "--resume"], standalone_mode=False)
    kept = (tmp_path / "cells.jsonl").read_text(encoding="utf-8")
    assert kept.count("imu:off") == 4
