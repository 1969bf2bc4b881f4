"""`hil jog` at a terminal: what moves while a key is held, and that a killed one stops the wheels.

The bench has servos alone: a computer that is late for cameras and IMUs ends no session here.
"""

import contextlib
import io
import json
import os
import pty
import queue
import subprocess
import sys
import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

from hil.cli import main
from hil.recording.mcap_reader import read_cycles
from tests.patience import patient_bench

LIMIT_S = 300.0
ALONE = dict.fromkeys(("encoders", "imu", "tracker", "mocap"))
WATCHDOG, PRESENT_VELOCITY, TRIGGERED = 98, 128, 0xFF

pytestmark = [pytest.mark.timeout(600), pytest.mark.real_time, pytest.mark.usefixtures("warm_commands")]


class Jog:
    """A running `hil jog` with a keyboard, and the figures that it tells of its loop."""

    def __init__(self, folder, bench, *options):
        self.keyboard, line = pty.openpty()
        self.folder = folder
        words = ["--progress", "json", "jog", "--bench", str(bench), *options, "--json"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil.cli", *words],
            stdin=line,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
        )
        os.close(line)
        self._said, self.lines = queue.SimpleQueue(), []
        self._listener = threading.Thread(target=self._listen)
        self._listener.start()

    def _listen(self):
        for said in self.process.stderr:
            self.lines.append(said)
            self._said.put(said)

    def until(self, seen, key=b""):
        """Hold a key, or none, until the figures of the loop are so."""
        end_s = time.monotonic() + LIMIT_S
        while True:
            assert self.process.poll() is None, "".join(self.lines)
            assert time.monotonic() < end_s, "".join(self.lines)
            if key:
                os.write(self.keyboard, key)
            with contextlib.suppress(queue.Empty):
                said = self._said.get(timeout=0.03)
                if said.startswith('{"live"') and seen(json.loads(said)["live"]):
                    return

    def close(self):
        """Wait for the end of the process, and close what leads to it."""
        self.process.wait(LIMIT_S)
        self._listener.join(LIMIT_S)
        for end in (self.process.stdout, self.process.stderr):
            end.close()
        with contextlib.suppress(OSError):
            os.close(self.keyboard)

    def end(self):
        """Exit code, summary, and path of the recording."""
        out = self.process.stdout.read()
        self.close()
        (path,) = (self.folder / "out" / "live").glob("*/recording.mcap")
        return self.process.returncode, json.loads(out), path


def fastest(figures):
    """Rate of the fastest wheel, rad/s; None while a wheel's is not known."""
    rates = figures["wheel_rad_s"]
    return None if rates is None or None in rates else max(map(abs, rates))


def turns(figures):
    return fastest(figures) is not None and fastest(figures) > 0.1


def rests(figures):
    return fastest(figures) is not None and fastest(figures) < 0.01


def steered(figures):
    return figures["steering_rad"] is not None and abs(figures["steering_rad"][1]) > 0.05


def replayed(path):
    """Verdict of `hil replay --verify`."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        main(["replay", str(path), "--verify", "--json"])
    return json.loads(out.getvalue())["verdict"]


@pytest.mark.parametrize("what", ["--wheel", pytest.param("--steer", marks=pytest.mark.long)])
def test_one_joint_moves_while_the_key_is_held(tmp_path, what):
    jog = Jog(tmp_path, patient_bench(tmp_path, "emulated_floor", **ALONE), what, "BL")
    jog.until(rests)
    jog.until(turns if what == "--wheel" else steered, b"w")
    jog.until(rests)
    os.write(jog.keyboard, b"x")
    code, summary, path = jog.end()
    assert code == 0, jog.lines
    (start,) = [k for k, said in enumerate(jog.lines) if "at the start" in said]
    assert any("hold a key" in said for said in jog.lines[start:]), "keys count once the bench is open"
    assert summary["ended"] == "key x"
    assert summary["held"]["moved_m"] < 0.01, "at rest, torque on"
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


def test_on_a_wall_the_robot_is_held_after_a_wheel_was_moved(tmp_path):
    """Motion capture sees that it does not slide."""
    seen = {name: table for name, table in ALONE.items() if name != "mocap"}
    jog = Jog(tmp_path, patient_bench(tmp_path, "emulated", **seen), "--wheel", "FL", "--speed", "0.01")
    jog.until(rests)
    jog.until(turns, b"w")
    jog.until(rests)
    os.write(jog.keyboard, b"x")
    code, summary, _ = jog.end()
    assert code == 0, jog.lines
    assert summary["held"]["state"] == "HELD", summary["held"]
    assert summary["held"]["moved_m"] < 0.01


def test_the_body_moves_ahead_and_a_closed_terminal_stops_it(tmp_path):
    jog = Jog(tmp_path, patient_bench(tmp_path, "emulated_floor", **ALONE), "--body")
    jog.until(rests)
    jog.until(lambda figures: figures["pose"][0] > 0.01, b"w")
    os.close(jog.keyboard)
    code, summary, path = jog.end()
    assert code == 4, jog.lines
    assert summary["held"]["moved_m"] < 0.01
    references = [r.reference for r in read_cycles(path) if r.reference is not None]
    assert references[-1].pose_in_wall[0] > references[0].pose_in_wall[0] + 0.01
    assert replayed(path) == "identical"


def answered(read, *register):
    """What the stock SDK reads; it waits for some ms only, so on a busy computer it asks again."""
    results = []
    while len(results) < 100:
        value, result, _ = read(*register)
        if result == COMM_SUCCESS:
            return value
        results.append(result)
    raise AssertionError(results)


def test_in_a_mix_a_killed_terminal_stops_the_wheels_within_the_bus_watchdog(tmp_path):
    """The servos are another program's, at a port; the bench emulates its encoders. Nothing speaks after."""
    words = ["emulate", "--bench", "emulated_floor", "--only", "servos"]
    with subprocess.Popen(
        [sys.executable, "-m", "hil.cli", *words], stdout=subprocess.PIPE, text=True
    ) as servos:
        try:
            served = json.loads(servos.stdout.readline())["servos"]
            where = {"servos.backend": "real", "servos.port": served["port"], "servos.baud": served["baud"]}
            mixed = patient_bench(tmp_path, "emulated_floor", **where, **{**ALONE, "encoders": {}})
            jog = Jog(tmp_path, mixed, "--wheel", "FL", "--emulate", "encoders")
            jog.until(rests)
            jog.until(turns, b"w")
            port, packets = PortHandler(served["port"]), PacketHandler(2.0)
            jog.process.kill()
            jog.process.wait()
            threading.Event().wait(0.1)  # any request would feed the watchdog, which waits for 0.08 s
            jog.close()
            assert port.setBaudRate(served["baud"])
            assert answered(packets.read1ByteTxRx, port, served["ids"][0], WATCHDOG) == TRIGGERED
            rates = []
            while not rates or rates[-1]:  # it rolls out by its own deceleration
                rates.append(answered(packets.read4ByteTxRx, port, served["ids"][0], PRESENT_VELOCITY))
                assert len(rates) < 200, rates
            port.closePort()
            assert all(late <= early + 1 for early, late in pairwise(rates)), (
                "one count is the register's noise"
            )
        finally:
            servos.terminate()
            servos.wait(LIMIT_S)


def test_without_a_terminal_or_a_choice_nothing_begins(capsys):
    assert main(["jog", "--wheel", "FL", "--body"]) == 2
    assert "one of" in capsys.readouterr().err
    assert main(["jog", "--steer", "FL"]) == 2
    assert "terminal" in capsys.readouterr().err
