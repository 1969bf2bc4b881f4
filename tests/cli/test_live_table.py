"""The table of `hil live` on a terminal shows what the loop told, and never holds up the loop."""

import fcntl
import os
import pty
import re
import select
import struct
import termios
import time

import pytest

from hil.bench import open_bench
from hil.bench.hold.held_state import held_in_words
from hil.cli.live import text_of
from hil.cli.live_table import LiveTable, frame, table
from hil.config.loading import load_bench
from hil.core.clock import Clock, nanoseconds
from hil.core.interfaces import Sink
from hil.core.watched_robot import WatchedRobot

ROWS, COLUMNS = 40, 100


class At(Clock):
    """A clock that is half a second later whenever it is read."""

    ns = 0

    def now_ns(self):
        self.ns += nanoseconds(0.5)
        return self.ns

    def sleep_until_ns(self, t_ns):
        raise AssertionError

    def schedule(self, task, due_ns):
        raise AssertionError


class Kept(Sink):
    def __init__(self):
        self.records = []

    def write(self, record):
        self.records.append(record)

    def close(self):
        pass


@pytest.fixture(scope="module")
def records():
    kept = Kept()
    with open_bench("emulated_floor") as bench:
        bench.add_sink(kept)
        bench.observe(0.2, feedback="odometry")
    return kept.records


@pytest.fixture
def terminal():
    """Both ends of a terminal: the one that a person sees, and the one that is written to."""
    seen, written = pty.openpty()
    fcntl.ioctl(written, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
    with os.fdopen(written, "w") as file:
        yield seen, file
    os.close(seen)


def screen(seen, until):
    """What was written to the terminal, up to this end."""
    data, limit_s = b"", time.monotonic() + 60.0
    while not re.search(until, data):
        assert time.monotonic() < limit_s, data
        if select.select([seen], [], [], 1.0)[0]:
            data += os.read(seen, 65536)
    return data


def test_every_device_is_on_the_screen_with_its_newest_values(records, terminal):
    seen, file = terminal
    table = LiveTable(file, At(), load_bench("emulated_floor"))
    for record in records[:-1]:
        table.write(record)
        table.rest()
        shown = screen(seen, rb"\x1b\[\d+A$").decode()  # a frame leaves the cursor above it
    table.close()
    assert screen(seen, rb"\x1b\[J$") == b"\x1b[J", "nothing is left of it"
    assert re.search(r"servos\s+\S+ of 100 Hz\s+\d+ ms  ok", shown)
    for name in ("servos", "encoders", "imu", "tracker"):
        assert re.search(rf"^{name}\s", shown, re.M), name
    angles = [s for r in records[:-1] for s in r.inputs.servos][-1].position_rad
    words = " ".join(shown.split())
    told = re.search(r"servos: Servo angles \(rad\):((?: \w+ -?[\d.e-]+){8})", words)[1].split()[1::2]
    assert list(map(float, told)) == pytest.approx(angles.tolist(), rel=1e-2, abs=1e-6)


def test_a_watched_robot_takes_the_place_of_figures_that_are_true_no_more(records, terminal):
    seen, file = terminal
    shown = LiveTable(file, At(), load_bench("emulated_floor"))
    shown.write(records[0])
    shown.rest()
    screen(seen, rb"\x1b\[\d+A$")
    shown.watched(WatchedRobot("robot stopped (adhesion): the fan is off", "it slides", None))
    text = " ".join(screen(seen, rb"\x1b\[\d+A$").decode().split())
    assert text.startswith("\x1b[J"), "what stood there is gone"
    assert "the loop has stopped: robot stopped (adhesion): the fan is off" in text
    assert "mm/s" not in text
    shown.close()


def test_a_terminal_that_stands_still_holds_up_nothing(records, terminal):
    _, file = terminal
    table = LiveTable(file, At(), load_bench("emulated_floor"))
    for _ in range(100):  # far more than a terminal takes before somebody reads it
        table.write(records[0])
        table.rest()
    table.close()


def test_what_does_not_fit_the_window_is_left_out():
    device = {"due_hz": None, "rate_hz": 10.0, "age_ms": None, "status": "ok"}
    values = {"a": {f"value_{k}": 1.0 for k in range(60)}}
    robot = {"bench": "b", "robot": "real", "t_s": 1.0, "pose": [None] * 3, "twist": [None] * 3}
    figures = {**robot, "adhesion_n": None, "devices": {"own": {**device, "values": values}}}
    text = frame(table(figures), 40, 12)
    lines = text.split("\n")[1:]
    assert len(lines) < 12
    assert max(map(len, lines[:-1])) < 40
    assert text.endswith(f"\x1b[{len(lines)}A")


@pytest.mark.parametrize("late", [0.0, 1.0])
def test_the_times_of_the_sections_are_told_where_a_cycle_was_late(late):
    """An operator whose session was in order reads what holds the robot, and no table of milliseconds."""
    with open_bench("emulated_floor") as bench:
        bench.observe(0.1, feedback="odometry")
    summary = {
        "bench": "floor",
        "ended": "key x",
        "rate_hz": 50.0,
        "timing": bench.statistics.summary() | {"late": late, "overruns": 0.0},
        "samples": {},
        "pose": None,
        "events": [],
        "held": bench.held.to_json(),
    }
    lines = text_of(summary).splitlines()
    assert any(line.startswith("estimate") for line in lines) == bool(late)
    assert lines[-1] == held_in_words(summary["held"])
