"""docs/hardware.md walked from top to bottom: every command, on a robot emulated behind ports as real ones.

A line that no rule knows fails its test, so that a new one is thought about. Each must end with 0. What needs
root or a package registry is only parsed by a shell, and its program has to be one that Debian has. What is
run in another form than it stands there is named in `OTHERWISE`, with the reason.
"""

import configparser
import contextlib
import itertools
import json
import os
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
from hil.core.registry import kinds
from hil.procedure.procedure_lookup import load_procedure
from hil.support.file_reading import read_toml

pytestmark = pytest.mark.usefixtures("warm_commands")

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
    "slcand",
    "systemctl",
    "tee",
    "udevadm",
    "usermod",
}
ENDS_S = 20.0
DISCOVERED = ("servos", "imu", "encoders", "mocap", "adhesion", "load_cells")


def lines(page):
    """Lines of a page's shell blocks, without their comments, each once."""
    text = page.read_text(encoding="utf-8")
    found = [line.split("#")[0].strip() for block in BLOCK.findall(text) for line in block.splitlines()]
    return list(dict.fromkeys(line for line in found if line))


SHOWN = {page.name: lines(page) for page in PAGES}
HIL = list(dict.fromkeys(line for shown in SHOWN.values() for line in shown if line.startswith("hil ")))
OTHERS = [line for shown in SHOWN.values() for line in shown if not line.startswith("hil ")]


def test_a_remedy_for_the_machine_is_a_line_of_shell_with_programs_that_there_are():
    assert subprocess.run(["sh", "-n", "-c", "\n".join(OTHERS)], check=False).returncode == 0
    for part in (part for line in OTHERS for part in line.split(" | ")):
        program, *rest = shlex.split(part)
        assert program in BY_SYSTEM, program
        assert program != "sudo" or rest[0] in AS_ROOT, rest


def test_the_unit_starts_a_command_that_moves_nothing():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(ROOT / "examples" / "hil-live.service")
    words = unit["Service"]["ExecStart"].split()
    assert words[1:3] == ["live", "--bench"]
    assert not {"--trajectory", "--command"} & set(words)
    assert problem(words[1:]) == ""
    assert float(unit["Service"]["TimeoutStopSec"]) >= ENDS_S


OTHERWISE = {
    "hil commission --bench my.toml": (["--help"], "asks a person to carry the robot, and lasts an hour"),
    "hil live --bench my.toml --duration 60": (["--duration", "1"], "a second shows the same"),
    **{
        f"hil run {name} --bench my.toml": (["--dry-run"], "lasts minutes; tests/procedures runs it whole")
        for name in (
            "steering_zero",
            "odometry_calibration",
            "tracker_extrinsics",
            "adhesion_check",
            "imu_calibration",
            "latency",
            "surface_identification",
            "sensor_noise",
            "wall_tracking",
            "wall_ablation",
        )
    },
}
"""Lines that are not run as they stand there: what is added to them, and why."""
JUDGES_PUNCTUALITY = ("doctor", "accept", "run", "live")
"""What also judges how punctual this computer is, of which others may take time: each has three tries, and
must end with 0 in one of them; but see `only_late`."""
ON_THE_FLOOR = ("--set", "bench.environment.surface=floor", "--set", "bench.environment.tilt_rad=0")


def rule(line, robot):
    """The words with which a line is tried on the emulated robot; it must end with 0."""
    words = shlex.split(line.split(" | ")[0])[1:]
    added = [*OTHERWISE.get(line, ([], ""))[0]]
    if words[0] == "run":
        floor = load_bench(load_procedure(words[1]).bench).environment.kind == "floor"
        given = ON_THE_FLOOR if floor else ()  # as the page says before these lines
        return [*words, *given, *added]
    if words[0] == "discover":
        where = ("--on-stand", "--can", "udp_multicast:239.74.163.2", "--mocap", "127.0.0.1")
        return [*words, *(part for port in robot.ports() for part in ("--port", port)), *where]
    if words[0] == "setup":
        return [robot.ports()[0] if w == "/dev/ttyUSB0" else w for w in words]
    if words[0] == "accept":
        folder = f"{'mix' if '--emulate' in words else 'accepted'}{next(robot.numbers)}"
        return [*words, "--on-stand", "--out", folder]
    if words[0] in ("doctor", "info", "commission", "live"):
        return [*words, *added]
    raise AssertionError(f"no rule says how to try: {line}")


def scene(line):
    """Which robot a line is about: `new`, a servo as delivered; that on the `floor` or that on the `wall`."""
    words = line.split()
    moves = words[1] == "run" and line not in OTHERWISE
    return "new" if words[1] == "setup" else "floor" if moves else "wall"


def test_every_line_has_a_rule_and_every_exception_a_line(tmp_path):
    assert all(rule(line, Lab(tmp_path)) for line in HIL)
    assert set(OTHERWISE) <= set(HIL)
    assert all(reason for _, reason in OTHERWISE.values())


@contextlib.contextmanager
def at_once(priority):
    """This process, and what it starts, go first where that is allowed, as on a robot's computer."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


@contextlib.contextmanager
def emulator(folder, name, *options):
    """Endpoints of an emulator."""
    where = folder / f"{name}.json"
    command = [sys.executable, "-m", "hil.cli", "emulate", "--out", str(where), *options]
    with (folder / name).open("w") as reported:
        with at_once(20):  # hardware waits for no program
            process = subprocess.Popen(command, stdout=reported, stderr=reported)
        try:
            if main(["emulate", "--wait", str(where)]) != 0 and process.poll() == 3:
                pytest.skip(f"another program has a standard port: {(folder / name).read_text()}")
            yield json.loads(where.read_text())
        finally:
            process.terminate()
            process.wait(ENDS_S)
        assert process.returncode == 0


class Lab:
    """A robot at ports as Motive's and python-can's, with names as udev gives them, and its user's folder."""

    def __init__(self, folder):
        self.folder, self.found, self.numbers = folder, {}, itertools.count()
        self._links = {"servos": folder / "usb-FTDI_U2D2-port0", "imu": folder / "usb-CP2102-port0"}

    def ports(self):
        return [str(link) for link in self._links.values()]

    @contextlib.contextmanager
    def begun(self, name):
        """The emulator of a scene; the bench file of what was found is given to it."""
        options = ("--bench", self._file(name), "--standard-ports", *["--only", "servos"] * (name == "new"))
        with emulator(self.folder, name, *options) as endpoints:
            for kind, link in self._links.items():
                link.unlink(missing_ok=True)
                if kind in endpoints:
                    link.symlink_to(endpoints[kind]["port"])
            if self.found:
                self.described(endpoints, wall=name == "wall")
            yield endpoints

    def _file(self, name):
        """The shipped robot, and what is true of the one of a scene."""
        others = list(range(201, 208))
        alone = {"baud": 57600, "ids": [1, *others], "absent": others}
        truth = {
            "new": {f"emulation.servos.{key}": value for key, value in alone.items()},
            "floor": {"environment.surface": "floor", "environment.tilt_rad": 0.0},
            "wall": {},
        }[name]
        config, path = load_bench("emulated", overrides=truth), self.folder / f"{name}_robot.toml"
        free = {name: set(table.CHOSEN_BY_EMULATOR) for name, table in config.devices().items()}
        tree = config.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=free)
        path.write_text(tomli_w.dumps(tree))
        return str(path)

    def described(self, endpoints, *, wall=True):
        """What the page asks a person to add to the file, and patience with this computer's load."""
        tracker = kinds()["tracker"].models[0].connection(endpoints["tracker"])["endpoint"].model_dump()
        watchdog = {} if wall else {"watchdog_s": 0.5}  # on a wall a wheel must not run on for so long
        floor = {} if wall else {"environment": {"surface": "floor", "tilt_rad": 0.0}}
        tables = {
            **self.found,
            **floor,
            "servos": {**self.found["servos"], "reply_slack_s": 0.02, "retry_budget_s": 0.02, **watchdog},
            "imu": {**self.found["imu"], "reply_timeout_s": 0.1},
            "tracker": {"endpoint": tracker},
            "thrust": {"port": endpoints["thrust"]["port"]},
            "robot": {"name": "climber 2"},
            "record": {"folder": "robot"},
            "safety": {"servo_stale_s": 0.5},
        }
        (self.folder / "my.toml").write_text(tomli_w.dumps(tables))


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.timeout(1800)  # accept asks every device for everything, in real time, twice; bring_up moves
def test_the_page_can_be_walked(tmp_path, monkeypatch):
    """In its order: what one line leaves, the next one needs."""
    monkeypatch.chdir(tmp_path)
    lab = Lab(tmp_path)
    for name, lines in itertools.groupby((one for one in HIL if one in SHOWN["hardware.md"]), scene):
        with at_once(10), lab.begun(name) as endpoints:
            for line in lines:
                for _ in range(3 if line.split()[1] in JUDGES_PUNCTUALITY else 1):
                    words = rule(line, lab)
                    reported = subprocess.run(
                        [sys.executable, "-m", "hil.cli", *words], capture_output=True, text=True, check=False
                    )
                    if reported.returncode not in (1, 3):
                        break
                ended = reported.returncode == 0 or (name == "floor" and only_late(reported))
                assert ended, f"{line}: {reported.returncode}\n{reported.stdout}\n{reported.stderr}"
                assert "Traceback" not in reported.stderr
                if line.startswith("hil setup"):
                    assert "operating_mode" in reported.stdout, reported.stdout
                if line.startswith("hil discover"):
                    lab.found = read_toml(Path("my.toml"))
                    assert set(DISCOVERED) <= set(lab.found)
                    assert lab.found["servos"]["port"] == lab.ports()[0]
                    lab.described(endpoints)
                if line.startswith("hil accept"):
                    accepted(Path(words[-1], "accept.json"), {"tracker", "mocap"} & set(words[-4].split(",")))
                if line.startswith("hil live"):
                    assert "at the start HELD" in reported.stderr
                    assert "\nHELD" in reported.stdout


def only_late(reported):
    """Whether a run measured its motions right, and failed by limits of punctuality alone, which a computer
    that is shared cannot keep: what comes after them is then not measured. Where samples come late, the clock
    of a device cannot be known from them either."""
    failed = [line.split()[1:3] for line in reported.stdout.splitlines() if line.startswith("FAIL ")]
    wrong = [name for name, value in failed if value != "-"]
    late = [name for name in wrong if name.endswith((".delivered", ".largest_gap", ".age"))]
    allowed = all(name in late or name.endswith((".clock_drift", ".clock_drift_least")) for name in wrong)
    return reported.returncode == 1 and bool(late) and allowed and "not needed: " in reported.stdout


def accepted(path, emulated):
    """All of it passed, and each device that was found is reported, with who it is."""
    reported = json.loads(path.read_text())
    devices = reported["devices"]
    assert reported["verdict"] == "PASS"
    assert set(DISCOVERED) <= set(devices)
    assert {name for name, one in devices.items() if one["backend"] == "emulated"} == emulated
    assert all(one["identity"] for one in devices.values())
