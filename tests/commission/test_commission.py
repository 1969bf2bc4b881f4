"""Commissioning: each procedure uses what the others found; the first failure ends it, resuming goes on."""

import errno
import json
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from absent_operator import AbsentOperator

from hil.cli import main
from hil.commission import Commission, commission, saved_state
from hil.commission import run as commission_run
from hil.commission.reruns import dependencies_of, reason_to_repeat
from hil.commission.run import _Running, found_signs
from hil.commission.saved_state import state_of
from hil.commission.stages import STAGES, Stage, placed, stages
from hil.config import profiles
from hil.config.loading import load_bench
from hil.config.robot_record import PARTS, Figure, NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.core.clock import MonotonicClock
from hil.core.errors import Aborted, ConfigError, UsageError
from hil.faults.files import read_faults
from hil.procedure import BenchSource
from hil.procedure.interrupts import Interrupts
from hil.procedure.measurements import Verdict
from hil.procedure.operator import Terminal, go_ahead
from hil.procedure.run_result import KEEPING, Failure, Result
from hil.procedures.wall_ablation import EVERYTHING, NOTHING
from hil.report import commission_page
from hil.support.folder_lock import locked

TINY = (
    Stage("tracker_extrinsics", "floor", 1.0, {"turn_deg": 30.0, "way_m": 0.15, "repetitions": 1}),
    Stage(
        "wall_ablation",
        "wall",
        1.0,
        {"length_m": 0.1, "duration_s": 4.0, "hold_s": 0.5, "cases": ("x_line",), "processes": 1},
    ),
)
SOURCE = BenchSource("emulated_delivered", seed=1)
PROFILES = Path(profiles.__file__).parent


def asked(folder, **changes):
    given = {"source": SOURCE, "operator": AbsentOperator(), "order": TINY, **changes}
    return Commission(folder=folder, clock=MonotonicClock(), now=lambda: "2026-11-22T12:00:00+00:00", **given)


@pytest.mark.long
def test_what_one_procedure_finds_the_next_one_uses(tmp_path):
    reported, code = commission(asked(tmp_path / "out"))
    assert (reported["verdict"], code, reported["stopped"]) == ("PASS", 0, None), reported
    assert reported["procedures"] == {"tracker_extrinsics": "PASS", "wall_ablation": "PASS"}
    assert list(RobotRecord(Path(reported["robot"])).read().parts) == ["camera"]
    assert list(reported["wall"]) == [NOTHING, EVERYTHING]
    assert set(reported["wall"][NOTHING]["x_line"]) >= {"end_m", "rmse_x_m", "rmse_y_m", "rmse_heading_rad"}
    assert reported["wall"][NOTHING] != reported["wall"][EVERYTHING]
    states = {row["key"]: (row["state"], row["by"], row["on"]) for row in reported["parameters"]}
    assert states["tracker.scale"] == ("confirmed", "tracker_extrinsics", "2026-11-22")
    assert states["robot.mass_kg"][0] == states["thrust.full_force_n"][0] == "unconfirmed"
    assert "robot.mass_kg" in Path(reported["page"]).read_text()


def test_what_has_passed_is_not_repeated(tmp_path, passing):
    folder = tmp_path / "out"
    for options in ({}, {"resume": True}):
        assert commission(asked(folder, **options))[1] == 0
    assert passing == ["tracker_extrinsics", "wall_ablation"]
    with pytest.raises(ConfigError, match=r"differs in seed \(1 then, 2 now\)"):
        commission(asked(folder, resume=True, source=SOURCE.changed(seed=2)))
    concrete = SOURCE.changed(overrides={"environment.surface": "concrete"})
    with pytest.raises(ConfigError, match=r"differs in settings.*concrete"):
        commission(asked(folder, resume=True, source=concrete))
    with pytest.raises(ConfigError, match="holds a commissioning"):
        commission(asked(folder))


def test_one_that_is_at_work_is_left_alone(tmp_path, passing):
    folder = tmp_path / "out"
    assert commission(asked(folder))[1] == 0
    before = (folder / "commission.json").read_bytes()
    with locked(folder, "a commissioning"):
        for resume in (True, False):
            with pytest.raises(UsageError, match="a commissioning is at work there"):
                commission(asked(folder, resume=resume))
    assert (folder / "commission.json").read_bytes() == before


def test_the_first_failure_ends_it_with_what_to_do_and_resuming_goes_on_there(tmp_path):
    blind = replace(SOURCE, faults=read_faults(("tracker:off@0",)))
    reported, code = commission(asked(tmp_path / "out", source=blind))
    assert (reported["verdict"], code) == ("ERROR", 3)
    assert list(reported["procedures"]) == ["tracker_extrinsics"]
    assert "hil commission --resume --out" in reported["stopped"]["do"]
    assert "tracker" in reported["stopped"]["why"]
    assert not Path(reported["robot"]).exists()
    assert reported["stopped"]["report"].endswith("01_tracker_extrinsics/report.html")
    assert "Stopped at tracker extrinsics" in Path(reported["page"]).read_text()


def test_what_the_bench_lacks_is_left_out_and_said():
    config = load_bench(
        "emulated_delivered", overrides={"load_cells": None, "adhesion": None, "thrust": None}
    )
    left_out = {stage.name: why for stage, why in stages(config, STAGES) if why}
    assert left_out == {"adhesion_check": "the bench has no adhesion, load_cells"}
    floor = load_bench("emulated_floor")
    assert {stage.place for stage, why in stages(floor, STAGES) if not why} == {"floor"}


def test_what_is_measured_on_top_of_something_comes_after_it():
    order = [stage.name for stage in STAGES]
    for kind in PARTS.values():
        for below in kind.on:
            assert order.index(PARTS[below].measured_by) <= order.index(kind.measured_by)
    assert {kind.measured_by for kind in PARTS.values()} | {"wall_ablation"} == set(order)


def test_on_the_floor_nothing_holds_the_robot_and_every_session_of_the_camera_is_another():
    config = load_bench("emulated_delivered")
    floor = load_bench("emulated_delivered", overrides=placed(STAGES[0], 1, config))
    assert not floor.environment.on_wall
    assert {"adhesion", "thrust", "load_cells"} & set(floor.devices()) == set()
    assert placed(STAGES[-1], 9, config) == {"emulation.tracker.session": 9}


def test_signs_that_bring_up_found_are_distinguished_from_those_believed(tmp_path):
    config = load_bench("emulated")
    (tmp_path / "bench_fragment.toml").write_text(
        "[alignment]\ndrive_sign = [1, -1, 1, 1]\nsteer_sign = [1, 1, 1, 1]\n"
    )
    assert found_signs(tmp_path, config)["alignment.drive_sign"] == [1, -1, 1, 1]
    assert found_signs(tmp_path / "none", config) == {}


def test_the_command_refuses_what_cannot_be_meant(tmp_path, capsys):
    assert main(["commission", "--set", "repetitions=2", "--out", str(tmp_path / "a")]) == 2
    assert "bench.KEY=VALUE" in capsys.readouterr().err
    assert main(["commission", "--resume", "--out", str(tmp_path / "b"), "--json"]) == 2
    assert "no commissioning to resume" in json.loads(capsys.readouterr().out)["error"]["message"]
    assert main(["commission", "--bench", "no_such_bench"]) == 2


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(3))
def test_a_robot_as_delivered_ends_within_8_mm(tmp_path, capsys, seed):
    """The whole quick form; `benchmarks/commissioned_robots.py` does it for many."""
    assert main(["commission", "--quick", "--seed", str(seed), "--out", str(tmp_path / "out"), "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    known, nothing = reported["wall"][EVERYTHING], reported["wall"][NOTHING]
    assert known["x_line"]["end_m"] < 8e-3
    assert known["y_line"]["end_m"] < 5e-3
    assert known["x_line"]["rmse_heading_rad"] < 0.002
    assert known["x_line"]["end_m"] < nothing["x_line"]["end_m"]
    assert set(reported["procedures"].values()) <= {"PASS", "MARGINAL"}


def test_an_ended_commissioning_names_how_it_goes_on_and_nothing_to_mend(tmp_path):
    interrupts = Interrupts()

    def strike(what, done, total):
        interrupts.handle(signal.SIGINT)

    with interrupts.deferred():
        reported, code = commission(asked(tmp_path / "out", interrupts=interrupts, report=strike))
    assert (reported["verdict"], code) == ("ABORTED", 4)
    assert reported["stopped"]["do"].startswith(f"hil commission --resume --out {tmp_path / 'out'}, with")


def test_a_signal_ends_it_while_a_person_is_asked_to_move_the_robot(tmp_path):
    """No operator answers then: a stop that waited for the answer would never come."""
    interrupts = Interrupts()

    class Struck(AbsentOperator):
        def ask(self, question):
            interrupts.handle(signal.SIGTERM)
            raise AssertionError("the question was waited for")

    class Real(BenchSource):
        real = ("servos",)

    given = asked(tmp_path, operator=Struck(), interrupts=interrupts)
    there = Real(overrides={"record.folder": str(tmp_path / "robot")})
    run = _Running(replace(given, source=there), state_of(tmp_path, {}, resume=False), SOURCE.config)
    with interrupts.deferred(), pytest.raises(Aborted, match="SIGTERM"):
        run._moved_to("wall")


class Says:
    """An operator at a terminal, or one whose answers are from a file, who gives these answers."""

    def __init__(self, *answers):
        self.answers, self.questions = list(answers), []

    def ask(self, question):
        self.questions.append(question)
        return self.answers.pop(0)


class AtATerminal(Says, Terminal):
    pass


@pytest.mark.parametrize("answer", ["", "Yes", " ok "])
def test_an_empty_line_or_yes_goes_on(answer):
    assert go_ahead(Says(answer), "lift it, then press Enter") == answer


@pytest.mark.parametrize("answer", ["N", "abort"])
def test_no_ends_it(answer):
    person = AtATerminal(answer)
    with pytest.raises(Aborted, match="nothing moves"):
        go_ahead(person, "lift it, then press Enter")
    assert len(person.questions) == 1


def test_anything_else_is_asked_again_and_from_a_file_ends_it():
    person = AtATerminal("banana", "not yet", "yes")
    assert go_ahead(person, "lift it, then press Enter") == "yes"
    assert len(person.questions) == 3
    assert "banana" in person.questions[1]
    with pytest.raises(Aborted, match=r"'banana' is no answer to .*; expected Enter"):
        go_ahead(Says("banana", "yes"), "lift it, then press Enter")


def test_a_robot_that_was_not_placed_is_not_driven(tmp_path, monkeypatch):
    """ABORTED with its page, exit code 4, and nothing was opened."""
    monkeypatch.setattr(BenchSource, "real", ("servos",))
    monkeypatch.setattr(commission_run, "run_procedure", lambda *_: pytest.fail("something was run"))
    reported, code = commission(asked(tmp_path / "out", operator=Says("no")))
    assert (reported["verdict"], code, reported["stopped"]["procedure"]) == (
        "ABORTED",
        4,
        "tracker_extrinsics",
    )
    assert "'no' was the answer" in reported["stopped"]["why"]
    assert Path(reported["page"]).is_file()


CAMERA, ABLATION = TINY
PART = Part(procedure="tracker_extrinsics", verdict="PASS", measured="2026-11-22T12:00:00", bench="lab")


def config_of(**overrides):
    return SOURCE.changed(overrides=overrides).config


@pytest.mark.parametrize(
    ("key", "value", "repeated"),
    [
        ("monitor.mesh_unit_m", 0.001, ()),
        ("imu.prefetch", False, ("wall_ablation",)),
        ("tracker.scale_sigma", 0.1, ("tracker_extrinsics", "wall_ablation")),
        ("robot.mass_kg", 3.3, ("tracker_extrinsics", "wall_ablation")),
        ("adhesion.rated_force_n", 44.0, ("wall_ablation",)),
    ],
)
def test_what_rests_on_a_key_that_has_changed_is_repeated_and_named(key, value, repeated):
    now = config_of(**{key: value})
    before = dependencies_of(SOURCE.config, {}, None)
    found = {stage.name: reason_to_repeat(stage, before, now, {}) for stage in TINY}
    assert tuple(name for name, why in found.items() if why) == repeated
    for name in repeated:
        assert f"the bench file has changed in {key} (" in found[name]
        assert f"{value!r} now)" in found[name]


def test_a_part_that_is_gone_or_another_has_its_procedure_repeated():
    before = json.loads(json.dumps(dependencies_of(SOURCE.config, {"camera": PART}, {"parts": ["camera"]})))
    assert reason_to_repeat(CAMERA, before, SOURCE.config, {"camera": PART}) == ""
    assert "camera is no longer in the record" in reason_to_repeat(CAMERA, before, SOURCE.config, {})
    other = PART.model_copy(update={"figures": {"scale": Figure(value=1.02)}})
    assert "is another than it had left" in reason_to_repeat(CAMERA, before, SOURCE.config, {"camera": other})


STATE = {
    "options": {"seed": 1},
    "done": {"bring_up": {"verdict": "PASS"}},
    "rests_on": {"bring_up": {"bench": {}, "parts": {}}},
}


@pytest.mark.parametrize(
    "damaged",
    [
        [],
        {},
        {**STATE, "options": None},
        {**STATE, "done": {"bring_up": "PASS"}},
        {**STATE, "rests_on": {}},
        {**STATE, "rests_on": {"bring_up": {"bench": {}}}},
    ],
)
def test_a_saved_state_that_is_not_whole_is_refused(tmp_path, damaged):
    path = tmp_path / "commission.json"
    path.write_text(json.dumps(STATE))
    assert state_of(tmp_path, {"seed": 1}, resume=True).passed("bring_up")
    path.write_text(json.dumps(damaged))
    with pytest.raises(ConfigError, match="commissioning"):
        state_of(tmp_path, {"seed": 1}, resume=True)


@pytest.fixture
def passing(monkeypatch):
    """Procedures that pass at once and leave their part; the names of those that were run."""
    ran = []

    def run(proc, source, options):
        ran.append(proc.name)
        left = [name for name, kind in PARTS.items() if kind.measured_by == proc.name]
        record = RobotRecord(Path(source.config.record.folder))
        new = {name: NewPart(PART.model_copy(update={"measured": f"{len(ran)}"})) for name in left}
        if new:
            record.add(new, identity(source.config, source.seed), created="2026-11-22", why=proc.name)
        facts = {"data": {}, "record": {"parts": left} if left else None, "duration_s": 1.0, "held": None}
        return Result(proc.name, Verdict.PASS, options.folder, [], facts)

    monkeypatch.setattr(commission_run, "run_procedure", run)
    return ran


def test_a_resumed_one_repeats_what_the_record_no_longer_holds_and_what_shows_it(tmp_path, passing):
    folder = tmp_path / "out"
    three = (Stage("steering_zero", "floor", 1.0), *TINY)
    assert commission(asked(folder, order=three))[1] == 0
    assert passing == ["steering_zero", "tracker_extrinsics", "wall_ablation"]
    RobotRecord(folder / "robot").apply(1)
    said = []
    reported, code = commission(
        asked(folder, order=three, resume=True, report=lambda what, *_: said.append(what))
    )
    assert (code, passing[3:]) == (0, ["tracker_extrinsics", "wall_ablation"])
    assert "tracker_extrinsics again: its part camera is no longer in the record" in said
    why = {stage["name"]: stage.get("why", "") for stage in reported["stages"]}
    assert why["steering_zero"] == ""
    assert "repeated: its part camera is no longer" in why["tracker_extrinsics"]
    assert "tracker_extrinsics is repeated" in why["wall_ablation"]
    assert set(RobotRecord(folder / "robot").read().parts) == {"zeros", "backlash", "camera"}


def test_a_procedure_is_given_those_faults_that_its_devices_can_have(tmp_path, monkeypatch):
    given, facts = {}, {"data": {}, "record": None, "duration_s": 1.0, "held": None}

    def run(proc, source, options):
        given[proc.name] = tuple(map(str, source.faults))
        source.check_faults()
        return Result(proc.name, Verdict.PASS, options.folder, [], facts)

    monkeypatch.setattr(commission_run, "run_procedure", run)
    faults = ("load_cells:wrong@0", "imu:stuck@1000")
    assert commission(asked(tmp_path / "out", source=replace(SOURCE, faults=read_faults(faults))))[1] == 0
    assert given == {"tracker_extrinsics": ("imu:stuck@1000",), "wall_ablation": faults}


def test_what_was_left_out_is_run_once_the_bench_has_the_device(tmp_path, passing):
    path, folder = tmp_path / "my.toml", tmp_path / "out"
    text = (PROFILES / "emulated_delivered.toml").read_text()
    path.write_text(text + "\n")
    zero = (Stage("steering_zero", "floor", 1.0),)
    with_it = BenchSource(path, seed=1)
    path.write_text(text.replace('[encoders]\nbackend = "emulated"', ""))
    reported, _ = commission(asked(folder, order=zero, source=BenchSource(path, seed=1)))
    assert (reported["procedures"], passing) == ({"steering_zero": "SKIPPED"}, [])
    path.write_text(text)
    commission(asked(folder, order=zero, source=with_it, resume=True))
    assert passing == ["steering_zero"]


def test_on_a_full_disk_it_ends_as_a_run_does(tmp_path, monkeypatch, capsys):
    """Nothing can be kept: the verdict, how the robot was left and what to do are reported all the same."""
    held = {"state": "HELD", "moved_m": 0.0, "why": "torque on"}
    problem = Failure("DataError", "result.json: cannot be written", KEEPING, 4)

    def run(proc, source, options):
        facts = {"data": {}, "held": held, "duration_s": 1.0}
        return Result(proc.name, Verdict.ERROR, options.folder, [], facts, teardown_errors=(problem,))

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(commission_run, "run_procedure", run)
    monkeypatch.setattr(saved_state, "put_whole", full)
    monkeypatch.setattr(commission_page, "put_whole", full)
    folder = tmp_path / "out"
    assert main(["commission", "--quick", "--out", str(folder)]) == 4
    out, _ = capsys.readouterr()
    assert "stopped at bring_up (ERROR): result.json: cannot be written" in out
    assert "HELD: moved 0.0 mm since the stop; torque on" in out
    assert "make room on the disk" in out
    assert "start anew with another --out" in out
    assert "ERROR: the record of the robot is" in out
    assert "the page could not be written" in out
