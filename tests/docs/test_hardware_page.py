"""docs/hardware.md walked from top to bottom: every command, on a robot emulated behind ports as real ones.

A line that no rule knows fails its test, so that a new one is thought about. What needs root or a package
registry is only parsed by a shell, and its program has to be one that Debian has.
"""

import configparser
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import tomli_w
from shown_commands import problem

from hil.cli import main
from hil.config.loading import load_bench
from hil.fakes.standard_can import DEFAULT_PORT
from hil.procedure.scripts import load_procedure
from hil.vocabulary.kinds import kinds
from hil.vocabulary.reading import read_toml

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "docs" / name for name in ("hardware.md", "computer.md", "acceptance.md", "checklist.md")]
BLOCK = re.compile(r"^ *```sh\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
BY_SYSTEM = {"sudo", "echo", "ip"}
"""Programs of lines that are for a machine with devices."""
AS_ROOT = {
    "apt",
    "cpupower",
    "ip",
    "jetson_clocks",
    "modprobe",
    "nvpmodel",
    "systemctl",
    "tee",
    "udevadm",
    "usermod",
}
ENDS_S = 20.0


def lines(page):
    """Lines of a page's shell blocks, without their comments, each once."""
    text = page.read_text(encoding="utf-8")
    found = [line.split("#")[0].strip() for block in BLOCK.findall(text) for line in block.splitlines()]
    return list(dict.fromkeys(line for line in found if line))


SHOWN = {page.name: lines(page) for page in PAGES}
HIL = list(dict.fromkeys(line for shown in SHOWN.values() for line in shown if line.startswith("hil ")))
OTHERS = [line for shown in SHOWN.values() for line in shown if not line.startswith("hil ")]


@pytest.mark.parametrize("line", OTHERS)
def test_what_the_machine_is_told_is_a_line_of_shell_with_programs_that_there_are(line):
    assert subprocess.run(["sh", "-n", "-c", line], check=False).returncode == 0
    for part in line.split(" | "):
        program, *rest = shlex.split(part)
        assert program in BY_SYSTEM, program
        assert program != "sudo" or rest[0] in AS_ROOT, rest


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_picture_and_page_that_is_named_is_there(page):
    named = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    assert [name for name in named if not (page.parent / name).exists()] == []


def test_the_check_list_ticks_commands_that_there_are():
    text = (ROOT / "docs" / "checklist.md").read_text(encoding="utf-8")
    shown = [words.split() for words in re.findall(r"`hil ([^`]+)`", text)]
    assert {words[0] for words in shown} >= {"doctor", "accept", "commission", "live", "adhesion"}
    assert [problem(words) for words in shown] == [""] * len(shown)


def test_the_unit_starts_a_command_that_moves_nothing():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(ROOT / "examples" / "hil-live.service")
    words = unit["Service"]["ExecStart"].split()
    assert words[1:3] == ["live", "--bench"]
    assert not {"--trajectory", "--command"} & set(words)
    assert problem(words[1:]) == ""
    assert float(unit["Service"]["TimeoutStopSec"]) >= ENDS_S


def rule(line, robot):
    """How a line is tried on the emulated robot: its words, and the exit codes with which it may end.

    In real time this computer's load is judged, too: a device that it starved is no failure of the page.
    """
    words = shlex.split(line.split(" | ")[0])[1:]
    if words[0] in ("run", "commission"):
        tail = ["--dry-run"] if words[0] == "run" else ["--help"]
        if words[0] == "run" and load_bench(load_procedure(words[1]).bench).environment.kind == "floor":
            for key in ("surface=floor", "tilt_rad=0"):  # as the page says before these lines
                tail += ["--set", f"bench.environment.{key}"]
        return [*words, *tail], {0}
    if words[0] == "discover":
        ports = [part for port in robot["ports"] for part in ("--port", port)]
        return [*words, *ports, "--can", robot["can"], "--mocap", robot["mocap"]], {0}
    if words[0] == "setup":  # on a whole robot nobody is as delivered: at 57600 baud there is silence
        return [robot["servos"] if w == "/dev/ttyUSB0" else w for w in words], {3}
    if words[0] == "live":
        return ["1" if w == "60" else w for w in words], {0, 1, 3}
    if words[0] == "accept":
        given = ["--on-stand"] if "--bench" in words else []
        return [*words, *given, "--out", "accepted"], {
            0,
            1,
            3,
        }  # in real time this computer's load is judged, too
    if words[0] == "doctor":
        return words, {0, 3}
    if words[0] == "info":
        return words, {0}
    raise AssertionError(f"no rule says how to try: {line}")


def test_every_line_has_a_rule():
    robot = {"ports": ["a"], "can": "b", "mocap": "c", "servos": "d"}
    assert all(rule(line, robot) for line in HIL)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """A robot on its wall at ports as Motive's, with names as udev gives them, and the folder of its user."""
    folder = tmp_path_factory.mktemp("lab")
    where = folder / "endpoints.json"
    command = [sys.executable, "-m", "hil.cli", "emulate", "--standard-ports", "--out", str(where)]
    with (folder / "told").open("w") as told, subprocess.Popen(command, stdout=told, stderr=told) as process:
        try:
            assert main(["emulate", "--wait", str(where)]) == 0
            found = json.loads(where.read_text())
            by_id = folder / "by-id"
            by_id.mkdir()
            for name, kind in (("usb-FTDI_U2D2-port0", "servos"), ("usb-Silicon_Labs_CP2102-port0", "imu")):
                (by_id / name).symlink_to(found[kind]["port"])
            ports = [str(path) for path in sorted(by_id.iterdir())]
            yield {
                "folder": folder, "ports": ports, "servos": ports[0], "mocap": found["mocap"]["server"],
                "can": f"{found['can']['interface']}:{found['can']['channel']}", "endpoints": found,
            }  # fmt: skip
        finally:
            process.terminate()
            assert process.wait(ENDS_S) == 0


def described(robot, path):
    """What the page asks a person to add to the file, devices whose bus discovery cannot know on this host,
    and patience: this computer's load must not count as a device's silence."""
    tables, found = read_toml(path), robot["endpoints"]
    for name in ("tracker", "adhesion", "load_cells", "encoders"):
        tables[name] = dict(kinds()[name].models[0].reach(found[kinds()[name].shown_as]))
    tables["tracker"]["endpoint"] = tables["tracker"]["endpoint"].model_dump()
    tables["servos"] |= {"reply_slack_s": 0.02, "retry_budget_s": 0.02}
    tables["imu"] |= {"reply_timeout_s": 0.04}
    tables |= {
        "robot": {"name": "climber 2"},
        "record": {"folder": "robot"},
        "safety": {"servo_stale_s": 0.5},
    }
    path.write_text(tomli_w.dumps(tables))


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.timeout(900)  # accept asks every device for everything, in real time
def test_the_page_can_be_walked(robot, monkeypatch, capsys):
    """In its order: what one line leaves, the next one needs."""
    monkeypatch.chdir(robot["folder"])
    for line in (one for one in HIL if one in SHOWN["hardware.md"]):
        words, allowed = rule(line, robot)
        code = main(words)
        told = capsys.readouterr()
        assert code in allowed, f"{line}: {code}\n{told.out}\n{told.err}"
        assert "Traceback" not in told.err
        if words[0] == "live":
            assert "at the start HELD" in told.err
            assert "\nHELD" in told.out or code
        if words[0] == "discover":
            bench = Path("my.toml").read_text()
            alone = robot["endpoints"]["can"]["port"] == DEFAULT_PORT  # no other emulator on this host
            wanted = ("servos", "imu", "mocap", *["encoders"] * alone)
            assert all(f"[{kind}]" in bench for kind in wanted)
            assert "by-id" in bench
            described(robot, Path("my.toml"))
    devices = json.loads(Path("accepted/accept.json").read_text())["devices"]
    assert {"servos", "imu", "encoders", "mocap"} <= set(devices)
    assert all(device["backend"] == "real" and device["identity"] for device in devices.values())
