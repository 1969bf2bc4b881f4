"""Faults that a hand does: the operator is asked while the bench runs, and the times are those of Enter."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys

import pytest

from hil.bench.by_hand import HandFaults
from hil.faults.fault import parse_fault
from tests.served_as_real import served_as_real

pytestmark = pytest.mark.usefixtures("warm_commands")

WATCH = """
from hil.procedure import Context, procedure

@procedure(name="watch", needs=("imu",), measurements=[])
def run(ctx: Context) -> None:
    \"\"\"Watch the robot at rest.\"\"\"
    ctx.bench.observe(6.0)
"""


class Person:
    """An operator who has done what was asked when the test says so."""

    def __init__(self):
        self.asked, self.done = [], False

    def say(self, text):
        self.asked.append(text)

    def has_done(self):
        done, self.done = self.done, False
        return done


def test_the_times_of_a_fault_are_those_at_which_the_hand_did_it():
    person, now = Person(), [0]
    hands = HandFaults([parse_fault("imu:off@2+3")], person, lambda: now[0])

    def cycle(t_s, *, done=False):
        now[0], person.done = round(t_s * 1e9), done
        hands.write(None)

    cycle(1.9, done=True)  # nobody was asked yet
    assert person.asked == []
    cycle(2.0)
    cycle(2.1)
    assert len(person.asked) == 1
    cycle(4.5, done=True)
    cycle(4.9)
    assert len(person.asked) == 1
    cycle(5.0)
    cycle(6.2, done=True)
    cycle(9.0)
    assert len(person.asked) == 2
    (row,) = hands.report(9_000_000_000)
    assert (row["at"], row["begun_s"], row["ended_s"], row["messages"]) == ("hand", 4.5, 6.2, None)


def test_power_that_is_still_off_when_the_robot_stops_is_asked_for():
    person, now = Person(), [0]
    hands = HandFaults([parse_fault("imu:off@2")], person, lambda: now[0])
    for t_s, done in ((2, False), (3, True), (4, False)):
        now[0], person.done = t_s * 1_000_000_000, done
        hands.write(None)
    hands.end()
    assert len(person.asked) == 2
    assert hands.report(5_000_000_000)[0]["ended_s"] == 5.0


def test_a_fault_that_nobody_did_is_one_that_hit_nothing():
    now = [3_000_000_000]
    hands = HandFaults([parse_fault("imu:reset@2"), parse_fault("imu:off@9")], Person(), lambda: now[0])
    hands.write(None)
    assert [row["messages"] for row in hands.report(now[0])] == [0, None]  # the second was not due


def run(folder, bench, spec, *options, **streams):
    (folder / "watch.py").write_text(WATCH)
    command = [sys.executable, "-m", "hil.cli", "run", str(folder / "watch.py"), "--bench", str(bench)]
    return subprocess.Popen(
        [*command, "--fault", spec, *options, "--out", str(folder / "out")],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        **streams,
    )


@pytest.mark.real_time
@pytest.mark.opens_stand_ins
def test_an_operator_at_the_terminal_is_asked_and_his_times_are_in_the_result(tmp_path):
    keyboard, terminal = pty.openpty()
    with served_as_real(tmp_path, ["imu"]) as bench:
        child = run(tmp_path, bench, "imu:off@1.5+1", "--by-hand", stdin=terminal)
        asked = []
        for line in child.stderr:
            if "NOW:" in line:
                asked.append(line)
                os.write(keyboard, b"\n")
        out, _ = child.communicate(timeout=30)
        refused = run(tmp_path, bench, "imu:off@1.5+1", "--by-hand", stdin=subprocess.DEVNULL)
        told = refused.communicate(timeout=30)[1]
    os.close(keyboard)
    os.close(terminal)
    assert (child.returncode, len(asked)) == (0, 2), out
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    (row,) = result["injected"]
    assert row["at"] == "hand"
    assert 1.5 <= row["begun_s"] < 2.5 <= row["ended_s"] < 4.0
    assert refused.returncode == 2
    assert "terminal" in told


@pytest.mark.real_time
@pytest.mark.opens_stand_ins
def test_a_hand_that_does_nothing_makes_the_run_an_error(tmp_path):
    keyboard, terminal = pty.openpty()
    with served_as_real(tmp_path, ["imu"]) as bench:
        child = run(tmp_path, bench, "imu:reset@1.5", "--by-hand", stdin=terminal)
        told = child.communicate(timeout=60)[1]
    os.close(keyboard)
    os.close(terminal)
    assert child.returncode == 2, told
    assert json.loads((tmp_path / "out" / "result.json").read_text())["verdict"] == "ERROR"
