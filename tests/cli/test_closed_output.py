"""Whoever reads the output may go: the command ends quietly, in order, and what it leaves is complete."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from hil.calibration.synthetic import hidden_robot, simulate
from hil.datasets.plain_csv import write_plain
from tests.patience import patient_bench

pytestmark = pytest.mark.usefixtures("warm_commands")
SCRIPT = """
import sys

from hil.procedure import Context, Measurement, procedure
from hil.robot.trajectories import line

@procedure(name="short", needs=("servos",), measurements=[Measurement("value", "m", high=1.0)])
def run(ctx: Context) -> None:
    "Drives, measures, reports."
    for k in range(5):
        with ctx.step(f"drive {k}"):
            way = line((0.02 * k, 0, 0), (0.02 * k + 0.02, 0, 0), duration_s=1.0)
            ctx.bench.drive(way, feedback="odometry")
        print(f"drove {k}", file=sys.stderr, flush=True)
    ctx.measure("value", 0.5)
    ctx.note("after the drive")
"""
EMPTY = """
from hil.procedure import Context, procedure

@procedure(name="empty")
def run(ctx: Context) -> None:
    "Drives nothing."
    ctx.note("5 \\u2013 7 mm")
"""
NOISE = ("Traceback", "Exception ignored", "BrokenPipe")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("closed")
    (folder / "short.py").write_text(SCRIPT)
    (folder / "empty.py").write_text(EMPTY)
    write_plain(folder / "line_x_1.csv", simulate(hidden_robot(1), "line_x", "x", np.random.default_rng(1)))
    return folder


def hil(folder, *arguments, output="read", errors="read", **environment):
    """Exit code, standard output and standard error; `gone`: its reader has left, `closed`: never there."""
    command = [sys.executable, "-m", "hil.cli", *arguments]
    closed = " ".join(f"{n}>&-" for n, state in ((1, output), (2, errors)) if state == "closed")
    if closed:
        command = ["sh", "-c", f'exec "$@" {closed}', "sh", *command]
    reader, gone = os.pipe()
    os.close(reader)
    streams = {
        name: gone if state == "gone" else subprocess.PIPE
        for name, state in (("stdout", output), ("stderr", errors))
    }
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | environment,
        stdin=subprocess.DEVNULL,
        timeout=600,
        text=True,
        check=False,
        **streams,
    )
    os.close(gone)
    assert not [word for word in NOISE if word in f"{done.stdout}{done.stderr}"]
    return done.returncode, done.stdout, done.stderr


COMMANDS = {
    "list": ["list"],
    "evaluate": ["evaluate", "line_x_1.csv", "--json"],
    "sick doctor": ["doctor", "--bench", "emulated_floor", "--fault", "imu:off"],
    "live": ["live", "--bench", "emulated_floor", "--duration", "0.5"],
}


@pytest.mark.parametrize("name", ["list", "sick doctor"])
def test_a_command_that_only_reports_ends_with_what_it_found_whether_or_not_it_is_read(folder, name):
    code, *_ = hil(folder, *COMMANDS[name], output="gone")
    assert code == (3 if name == "sick doctor" else 0)


def test_a_character_that_the_terminal_lacks_is_escaped_and_the_verdict_stays(folder):
    """As on a terminal in Latin-1, which has neither this dash nor the quotation marks of the sentences."""
    code, said, _ = hil(folder, "run", "empty.py", PYTHONIOENCODING="iso-8859-1")
    assert code == 0
    assert "note: 5 \\u2013 7 mm" in said


@pytest.mark.real_time
def test_a_command_with_the_robot_in_hand_whose_reader_has_gone_ends_with_4(folder):
    patient_bench(folder, "emulated_floor")
    code, _, errors = hil(folder, "live", "--bench", "bench.toml", "--duration", "0.5", output="gone")
    assert code == 4
    assert "not needed: on the floor" in errors, "how the robot was left is said where it can be read"


@pytest.mark.parametrize(("name", "stream"), [("live", "output"), ("evaluate", "errors")])
def test_a_command_without_a_stream_does_not_begin(folder, name, stream):
    code, output, errors = hil(folder, *COMMANDS[name], **{stream: "closed"})
    assert code == 4
    assert not output
    assert ("standard output closed: nothing was started" in errors) == (stream == "output")


def test_a_run_whose_progress_is_not_read_is_aborted_with_the_robot_held(folder):
    command = [sys.executable, "-m", "hil.cli", "run", "short.py", "--out", "quiet"]
    with subprocess.Popen(
        command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as run:
        while "drove 0" not in run.stderr.readline():
            pass
        run.stderr.close()
        assert not [word for word in NOISE if word in run.stdout.read()]
    assert run.returncode == 4
    result = json.loads((folder / "quiet" / "result.json").read_text())
    assert (result["verdict"], result["exit_code"]) == ("ABORTED", 4)
    assert result["held"]["state"] == "HELD"
    done = [step["title"] for step in result["steps"] if step["outcome"] == "done"]
    assert done[:1] == ["drive 0"]
    assert "drive 4" not in done
    assert (folder / "quiet" / "recording.mcap").stat().st_size > 0
    assert json.loads((folder / "quiet" / "journal.jsonl").read_text().splitlines()[-1])["kind"] == "end"


def test_a_full_disk_behind_the_output_ends_with_4(folder):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "hil.cli", "list"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 4
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr
