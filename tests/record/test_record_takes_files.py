"""What a record takes from files: of this robot, of runs that passed, with values that can be meant."""

import json

import pytest

from hil.calibration.calibration_file import save_calibration
from hil.cli import main
from hil.config.loading import load_bench
from hil.config.robot_record import Figure, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.core.clock import MonotonicClock
from hil.core.errors import EXIT_PASS, EXIT_USAGE
from hil.procedure import BenchSource, Measurement, procedure
from hil.procedure.bench_fragment import write_fragment
from hil.procedure.operator import Terminal
from hil.procedure.record_parts import leave_part
from hil.procedure.runner import RunOptions, run_procedure
from tests.procedures.made_calibrations import made

ZEROS = [0.01, -0.02, 0.03, -0.04]
FILES = ("part_zeros.toml", "bench_fragment.toml")


@procedure(name="finds_zeros", measurements=[Measurement("off", "mm", high=1.0)])
def finds_zeros(ctx):
    """Leaves zeros as a part and as a piece of a bench file; fails on a robot with 11.5 V."""
    leave_part(ctx, "zeros", values={"alignment.steer_zero_rad": ZEROS}, figures={"FL": Figure(value=0.01)})
    write_fragment(ctx, {"alignment": {"steer_zero_rad": ZEROS}}, "Zeros.")
    ctx.measure("off", 10.0 * (ctx.source.config.robot.supply_v == 11.5))


def ran(folder, seed=0, **overrides):
    source = BenchSource("emulated", overrides={"robot.name": "climber 1", **overrides}, seed=seed)
    options = RunOptions(folder, MonotonicClock(), "2026-11-22T10:00:00", {}, operator=Terminal())
    return run_procedure(finds_zeros, source, options)


@pytest.fixture
def bench(tmp_path):
    """A bench file of the robot that the zeros are of, and one of another."""

    def named(name):
        path = tmp_path / f"{name.replace(' ', '_')}.toml"
        lines = (
            'schema = 1\nname = "b"\n[environment]\nstart_pose = [0.0, 0.0, 0.0]\n',
            f'[robot]\nname = "{name}"\n',
        )
        path.write_text(
            "".join(lines)
            + '[servos]\nbackend = "emulated"\nmodel_number = 1010\n[tracker]\nbackend = "emulated"\n'
        )
        return str(path)

    return named


def apply(record, source, bench, *more):
    words = ["robot", "apply", str(record), "--from", str(source), "--bench", bench, "--json", *more]
    return main(words)


def refused(capsys):
    error = json.loads(capsys.readouterr().out)["error"]
    return f"{error['message']}; {error.get('remedy')}"


@pytest.mark.parametrize("name", FILES)
def test_what_this_robot_has_left_is_taken_with_its_verdict(tmp_path, bench, name):
    result = ran(tmp_path / "run")
    assert result.verdict.value == "PASS"
    assert apply(tmp_path / "robot", tmp_path / "run" / name, bench("climber 1")) == EXIT_PASS
    part = RobotRecord(tmp_path / "robot").read().parts["zeros"]
    assert (part.procedure, part.verdict) == ("finds_zeros", "PASS")
    assert part.values["alignment.steer_zero_rad"] == ZEROS


@pytest.mark.parametrize("name", FILES)
def test_what_another_robot_has_left_is_refused(tmp_path, bench, name, capsys):
    ran(tmp_path / "run")
    for more in ((), ("--of-this-robot",)):
        assert apply(tmp_path / "robot", tmp_path / "run" / name, bench("climber 2"), *more) == EXIT_USAGE
        message = refused(capsys)
        assert "of another robot" in message
        assert "robot.name: 'climber 1' in the file, 'climber 2' here" in message
    assert not RobotRecord(tmp_path / "robot").exists()


def test_a_bench_that_names_no_seed_is_no_way_round_the_robot_of_the_record(tmp_path, bench, capsys):
    """Both are named alike; by their seeds they are two."""
    for seed in (3, 4):
        ran(tmp_path / str(seed), seed=seed)
    assert apply(tmp_path / "robot", tmp_path / "3" / FILES[0], bench("climber 1")) == EXIT_PASS
    capsys.readouterr()
    assert apply(tmp_path / "robot", tmp_path / "4" / FILES[1], bench("climber 1")) == EXIT_USAGE
    assert "of seed 4" in refused(capsys)


def calibrated(path, robot):
    """A calibration that has passed its validation; of this robot, or of none."""
    save_calibration(path, made(robot=robot, made_for=None))
    return path


def test_a_calibration_says_whose_it_is_too(tmp_path, bench, capsys):
    first = identity(load_bench("emulated", overrides={"robot.name": "climber 1"}), 0)
    source = calibrated(tmp_path / "calibration.toml", first)
    assert apply(tmp_path / "second", source, bench("climber 2"), "--of-this-robot") == EXIT_USAGE
    assert "robot.name: 'climber 1' in the file, 'climber 2' here" in refused(capsys)
    assert apply(tmp_path / "first", source, bench("climber 1")) == EXIT_PASS
    capsys.readouterr()
    older = calibrated(tmp_path / "older.toml", None)
    assert apply(tmp_path / "third", older, bench("climber 1")) == EXIT_USAGE
    assert "does not say of which robot it is" in refused(capsys)
    assert apply(tmp_path / "third", older, bench("climber 1"), "--of-this-robot") == EXIT_PASS


@pytest.mark.parametrize("alone", [False, True], ids=["beside its result", "alone"])
@pytest.mark.parametrize("name", FILES)
def test_what_a_run_left_that_failed_is_refused(tmp_path, bench, name, alone, capsys):
    result = ran(tmp_path / "run", **{"robot.supply_v": 11.5})
    assert result.verdict.value == "FAIL"
    source = tmp_path / "run" / name
    if alone:
        source = source.rename(tmp_path / name)
    assert apply(tmp_path / "robot", source, bench("climber 1"), "--of-this-robot") == EXIT_USAGE
    assert f"{source}: left by a run that ended in FAIL" in refused(capsys)


@pytest.mark.parametrize("name", FILES)
def test_a_result_has_the_last_word_on_how_the_run_ended(tmp_path, bench, name, capsys):
    ran(tmp_path / "run")
    result = tmp_path / "run" / "result.json"
    result.write_text(json.dumps(json.loads(result.read_text()) | {"verdict": "ERROR"}))
    assert apply(tmp_path / "robot", tmp_path / "run" / name, bench("climber 1")) == EXIT_USAGE
    assert "ended in ERROR" in refused(capsys)


FRAGMENT = "[alignment]\nsteer_zero_rad = [0.01, 0.0, 0.0, 0.0]\n"
PART = """part = "zeros"
procedure = "steering_zero"
verdict = "PASS"
measured = "2026-01-31"
bench = "emulated"
[values]
"alignment.steer_zero_rad" = {zeros}
"""


@pytest.mark.parametrize(
    ("name", "text", "by"),
    [
        ("bench_fragment.toml", FRAGMENT, ("taken from a file", "not verified")),
        ("part_zeros.toml", PART.format(zeros=ZEROS), ("steering_zero", "PASS")),
    ],
)
def test_a_file_that_does_not_say_whose_it_is_needs_an_option_that_does(
    tmp_path, bench, name, text, by, capsys
):
    source = tmp_path / name
    source.write_text(text)
    assert apply(tmp_path / "robot", source, bench("climber 1")) == EXIT_USAGE
    message = refused(capsys)
    assert f"{source}: does not say of which robot it is" in message
    assert "--of-this-robot" in message
    assert not RobotRecord(tmp_path / "robot").exists()
    assert apply(tmp_path / "robot", source, bench("climber 1"), "--of-this-robot") == EXIT_PASS
    part = RobotRecord(tmp_path / "robot").read().parts["zeros"]
    assert (part.procedure, part.verdict) == by


def with_zeros(zeros):
    return PART.format(zeros=zeros)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (with_zeros("[-3.0, 0.0, 0.0, 0.0]"), "-3: steering_zero lets -0.105 to 0.105 rad"),
        (with_zeros("[nan, 0.0, 0.0, 0.0]"), "alignment.steer_zero_rad: nan is no finite number"),
        (with_zeros("[1979-05-27, 0.0, 0.0, 0.0]"), "alignment.steer_zero_rad: a date is no number"),
        (with_zeros("[0.01, 0.0]"), "alignment.steer_zero_rad"),
        (with_zeros(ZEROS).replace("alignment.steer_zero_rad", "tracker.scale"), "belongs to camera"),
        (with_zeros(ZEROS).replace('"zeros"', '["zeros"]'), "is no part"),
        (with_zeros(ZEROS) + "[robot]\nname = 3\n", "robot: it cannot be read"),
        (FRAGMENT.replace("0.01", "nan"), "alignment.steer_zero_rad: nan is no finite number"),
        ("[alignment]\ndrive_sign = [1, 1, 2, 1]\n", "alignment.drive_sign.2: must be -1 or 1"),
        ("[tracker]\nscale = 0.5\n", "tracker.scale: 0.5: tracker_extrinsics lets 0.7 to 1.35"),
    ],
)
def test_values_that_cannot_be_meant_are_named_with_file_and_key(tmp_path, bench, text, reported, capsys):
    source = tmp_path / "found.toml"
    source.write_text(text)
    assert apply(tmp_path / "robot", source, bench("climber 1"), "--of-this-robot") == EXIT_USAGE
    out = capsys.readouterr()
    message = json.loads(out.out)["error"]["message"]
    assert str(source) in message
    assert reported in message
    assert "Traceback" not in out.err
    assert not RobotRecord(tmp_path / "robot").exists()


def test_a_device_that_the_bench_lacks_is_no_reason_to_refuse_what_is_known_of_it(tmp_path, bench):
    source = tmp_path / "found.toml"
    source.write_text("[load_cells]\nzero_n = [0.5, 0.4]\n")
    assert apply(tmp_path / "robot", source, bench("climber 1"), "--of-this-robot") == EXIT_PASS


def test_a_piece_of_a_bench_file_can_still_be_pasted_into_one(tmp_path):
    ran(tmp_path / "run")
    text = (tmp_path / "run" / "bench_fragment.toml").read_text()
    path = tmp_path / "pasted.toml"
    path.write_text('schema = 1\nname = "b"\n' + text)
    assert load_bench(path).alignment.steer_zero_rad == tuple(ZEROS)
    reported = next(line for line in text.splitlines() if line.startswith("# robot = "))
    robot = identity(load_bench("emulated", overrides={"robot.name": "climber 1"}), 0)
    assert json.loads(reported.removeprefix("# robot = ")) == robot.model_dump(mode="json", exclude_none=True)
