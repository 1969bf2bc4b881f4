"""Every reader of a file: sound files that the bench itself wrote, and what is done with spoilt ones."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from hil.bench import open_bench
from hil.calibration.artefact import read_calibration, write_calibration
from hil.calibration.calibrate import calibrate
from hil.calibration.datasets import Recording
from hil.calibration.problem import make_setting
from hil.calibration.synthetic import hidden_robot, make_set
from hil.cli import main
from hil.config.loading import load_bench
from hil.config.record import NewPart, Part, RobotRecord
from hil.config.record.folder import read_version
from hil.config.record.overlay import identity
from hil.drivers.imu.calibration import ImuCalibration
from hil.fakes.timeline import read_faults
from hil.procedure.commission.state import state_of
from hil.procedure.journal import read_journal
from hil.procedure.operator import Answers
from hil.recording.mcap_reader import RecordingReader, read_cycles
from hil.recording.mcap_writer import McapRecorder
from hil.recording.plain_csv import read_plain, write_plain
from hil.recording.public_csv import partner, read_pair
from hil.recording.topic_map import read_topic_map
from hil.report.result_file import read_result
from hil.report.run_page import write_run_page
from hil.robot.waypoints import read_waypoints
from hil.vocabulary.clock import MonotonicClock
from hil.vocabulary.errors import HilError
from hil.vocabulary.result_files import COMMISSIONING_TABLE, JOURNAL

TOPICS = b"""schema = 1
[wheels]
topic = "/joint_states"
drive = ["a", "b", "c", "d"]
steer = ["e", "f", "g", "h"]
[truth]
topic = "/pose"
"""
FAULTS = b'[[fault]]\ndevice = "imu"\nkind = "stuck"\nat_s = 2.0\nduration_s = 3.0\noptions = { }\n'


@dataclass(frozen=True)
class FileFed:
    """A reader of files.

    Attributes:
        name: of the reader.
        path: a sound file, in a folder of its own with what belongs to it; its bytes are spoilt in place.
        read: reads the file, and all of it.
    """

    name: str
    path: Path
    read: Callable[[Path], object]

    def __call__(self, data: bytes) -> None:
        """Read these bytes in place of the file's; anything but an error of ours goes through."""
        self.path.write_bytes(data)
        with suppress(HilError):
            self.read(self.path)


def _all(path: Path) -> None:
    for _ in RecordingReader(path).items():
        pass
    list(read_cycles(path, []))


def _written(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name.replace(".", "_") / name
    path.parent.mkdir(parents=True)
    path.write_bytes(data)
    return path


def _recording(folder: Path) -> Path:
    path = folder / "recording" / "run.mcap"
    path.parent.mkdir()
    with open_bench("sensors", emulate="all") as bench:
        bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
        bench.observe(0.1, feedback="odometry")
    return path


def _run(folder: Path) -> Path:
    script = _written(folder, "short.py", _SCRIPT)
    assert main(["run", str(script), "--out", str(folder / "run")]) == 0
    return folder / "run"


def _state(path: Path) -> None:
    state_of(path.parent, {"seed": 1}, resume=True).passed("bring_up")


def _record(folder: Path) -> Path:
    part = Part(
        procedure="a_test",
        verdict="PASS",
        measured="2026-11-22T10:00:00+00:00",
        bench="emulated",
        values={"tracker.scale": 1.004, "tracker.scale_sigma": 0.001},
    )
    robot, record = identity(load_bench("emulated")), RobotRecord(folder / "robot")
    record.add({"camera": NewPart(part)}, robot, created="2026-11-22T12:00:00+00:00", why="a test")
    return record.path


def _calibration(folder: Path, data: Sequence[Recording]) -> Path:
    path = folder / "calibration" / "calibration.toml"
    path.parent.mkdir()
    found = calibrate(data, make_setting("paper"), MonotonicClock(), validate=False)
    write_calibration(path, found, created="2026-11-22", software={"hil": "0.1.0"})
    return path


def _public(folder: Path) -> Path:
    names = str([f"{w}_{k}" for w in ("BL", "BR", "FL", "FR") for k in ("Position", "Wheel")])
    rows, poses = [_ODOM], [_ABS]
    for k in range(25):
        stamp, zeros = (
            f"2024/05/03/12:00:{k / 10:04.1f};{k};{1000 + k // 10};{k % 10}00000000",
            str((0.0,) * 8),
        )
        rows.append(f"{stamp};;{names};{(0.0, k / 10) * 4};{zeros};{zeros}")
        poses.append(f"{stamp};w;{k * 0.00254};0;0;0;0;0;1")
    path = _written(folder, "odom_1.csv", "\n".join([*rows, ""]).encode())
    path.with_name("abs_1.csv").write_text("\n".join([*poses, ""]))
    return path


_ODOM = (
    "time;.header.seq;.header.stamp.secs;.header.stamp.nsecs;.header.frame_id;.name;.position;"
    ".velocity;.effort"
)
_ABS = (
    "time;.header.seq;.header.stamp.secs;.header.stamp.nsecs;.header.frame_id;.pose.position.x;.pose.position.y;"
    ".pose.position.z;.pose.orientation.x;.pose.orientation.y;.pose.orientation.z;.pose.orientation.w"
)
_JOURNAL = b"\n".join(
    json.dumps(entry).encode()
    for entry in (
        {"kind": "run", "schema": 1, "procedure": "p", "parameters": {}, "seed": 1, "bench": {}},
        {"kind": "measure", "name": "a", "value": 0.5},
        {"kind": "checkpoint", "title": "one", "value": [1.0]},
        {"kind": "recording", "path": "a.mcap"},
    )
)
_COMMISSIONING = json.dumps({"options": {"seed": 1}, "done": {"bring_up": {"verdict": "PASS"}}}).encode()
_OFFSETS = b"""accelerometer_offset = [1, 2, 3]
magnetometer_offset = [1, 2, 3]
gyroscope_offset = [1, 2, 3]
accelerometer_radius = 1000
magnetometer_radius = 480
"""
_SCRIPT = b"""
from hil.procedure import Measurement, procedure

@procedure(name="short", measurements=[Measurement("a", "mm", high=1.0, rationale="r")])
def run(ctx):
    with ctx.step("one"):
        ctx.table("t", ["x"], [[1.0]])
        ctx.measure("a", 0.5)
"""


def files(folder: Path) -> list[FileFed]:
    """All readers, each with a sound file below `folder`."""
    profile = resources.files("hil.config.profiles").joinpath("emulated.toml").read_bytes()
    data = make_set(hidden_robot(6), 6, repetitions=1)
    table = _written(folder, f"{data[0].name}.csv", b"")
    write_plain(table, data[0])
    run = _run(folder)
    page = folder / "page"
    shutil.copytree(run, page)
    return [
        FileFed("bench file", _written(folder, "bench.toml", profile), load_bench),
        FileFed("fault timeline", _written(folder, "faults.toml", FAULTS), lambda p: read_faults([str(p)])),
        FileFed("topics", _written(folder, "topics.toml", TOPICS), read_topic_map),
        FileFed("waypoints", _written(folder, "way.csv", b"x,y,theta\n0,0,0\n0.1,0.2,0.3\n"), read_waypoints),
        FileFed("answers", _written(folder, "answers.txt", b"# mine\nplace it: yes\n2\n"), Answers),
        FileFed("journal", _written(folder, JOURNAL, _JOURNAL), read_journal),
        FileFed("commissioning", _written(folder, COMMISSIONING_TABLE, _COMMISSIONING), _state),
        FileFed("offsets", _written(folder, "imu.toml", _OFFSETS), ImuCalibration.load),
        FileFed("record", _record(folder), lambda p: read_version(p, "")),
        FileFed("calibration", _calibration(folder, data), read_calibration),
        FileFed("public data set", _public(folder), lambda p: read_pair(p, partner(p))),
        FileFed("data set", table, read_plain),
        FileFed("result", run / "result.json", lambda p: read_result(p.parent)),
        FileFed("run page", page / "result.json", lambda p: write_run_page(p.parent)),
        FileFed("recording", _recording(folder), _all),
    ]
