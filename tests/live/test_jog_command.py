"""`hil jog` at a terminal: what moves while a key is held, and that the robot is held after."""

import contextlib
import io
import json
import os
import pty
import subprocess
import sys
import time

import numpy as np
import pytest

from hil.cli import main
from hil.recording.mcap_reader import read_cycles
from tests.patience import patient_bench

LIMIT_S = 300.0

pytestmark = [pytest.mark.timeout(600), pytest.mark.real_time]


class Jog:
    """A running `hil jog` with a keyboard."""

    def __init__(self, folder, *options):
        bench = patient_bench(folder, "emulated")
        self.keyboard, line = pty.openpty()
        self.folder = folder
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil.cli", "jog", "--bench", str(bench), *options, "--json"],
            stdin=line,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
        )
        os.close(line)

    def hold(self, key, seconds):
        """Hold a key, from the time at which cycles are recorded on."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and self.process.poll() is None:
            os.write(self.keyboard, key)
            time.sleep(0.03)

    def begun(self):
        """Wait until the robot can be moved."""
        said = ""
        while "at the start" not in said:
            said = self.process.stderr.readline()
            assert said, "it ended before"
        time.sleep(2.0)

    def end(self):
        """Exit code, summary, messages, and the recorded cycles in which something could be commanded."""
        out, err = self.process.communicate(timeout=LIMIT_S)
        with contextlib.suppress(OSError):
            os.close(self.keyboard)
        (path,) = (self.folder / "out" / "live").glob("*/recording.mcap")
        return self.process.returncode, json.loads(out), err, path


def replayed(path):
    """Verdict of `hil replay --verify`."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        main(["replay", str(path), "--verify", "--json"])
    return json.loads(out.getvalue())["verdict"]


@pytest.mark.parametrize("what", ["--wheel", pytest.param("--steer", marks=pytest.mark.long)])
def test_one_joint_moves_while_the_key_is_held(tmp_path, what):
    jog = Jog(tmp_path, what, "BL")
    jog.begun()
    jog.hold(b"w", 1.0)
    time.sleep(0.8)
    os.write(jog.keyboard, b"x")
    code, summary, err, path = jog.end()
    assert code == 0, err
    assert summary["ended"] == "key x"
    assert summary["held"]["state"] == "HELD"
    cycles = [r for r in read_cycles(path) if r.external is not None]
    rates = np.array([r.setpoint.wheel_rate_rad_s for r in cycles])
    angles = np.array([r.setpoint.steering_rad for r in cycles])
    moved = rates if what == "--wheel" else angles - angles[0]
    others = angles - angles[0] if what == "--wheel" else rates
    assert moved[:, 1].max() > 0.05
    assert not np.delete(moved, 1, axis=1).any()
    assert not others.any()
    assert not rates[-1].any()
    assert replayed(path) == "identical"


def test_the_body_moves_ahead_and_a_closed_terminal_stops_it(tmp_path):
    jog = Jog(tmp_path, "--body")
    jog.begun()
    jog.hold(b"w", 1.5)
    os.close(jog.keyboard)
    code, summary, err, path = jog.end()
    assert code == 4, err
    assert summary["held"]["state"] == "HELD"
    references = [r.reference for r in read_cycles(path) if r.reference is not None]
    assert references[-1].pose_in_wall[0] > references[0].pose_in_wall[0] + 0.01
    assert replayed(path) == "identical"


def test_without_a_terminal_or_a_choice_nothing_begins(capsys):
    assert main(["jog", "--wheel", "FL", "--body"]) == 2
    assert "one of" in capsys.readouterr().err
    assert main(["jog", "--steer", "FL"]) == 2
    assert "terminal" in capsys.readouterr().err
