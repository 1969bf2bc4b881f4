"""Every command with wrong paths, wrong types and unwritable places: a code and a name, never a traceback.

The commands come from click's own tree, so a new one is walked as soon as it exists. Whatever a command
would open in real time is replaced: what gets that far has accepted its options.
"""

import contextlib
import io
from dataclasses import replace

import click
import pytest

from hil.bench import open_bench, open_emulation
from hil.cli import main
from hil.config.loading import load_bench
from hil.config.robot_record import NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError
from hil.core.registry import kinds
from hil.fault_matrix import lost
from hil.recording.mcap_writer import McapRecorder
from tests.command_tree import leaves
from tests.selected import every

SCRIPT = '''
"""Nothing to do."""
from hil.procedure import procedure


@procedure(name="idle", needs=())
def run(ctx):
    """Do nothing."""
'''
ROBOT = identity(load_bench("emulated_floor"))
ZEROS = NewPart(
    Part(
        procedure="steering_zero",
        verdict="PASS",
        measured="2026-11-22T10:00:00+00:00",
        bench="emulated_floor",
        values={"alignment.steer_zero_rad": [0.01, -0.02, 0.03, -0.04]},
    )
)
OUTPUTS = {"out", "page", "plots", "record", "folder"}
"""Names of parameters that say where to write; every other path is read."""

EMPTY_IS_FINE = {("empty", "answers"), ("a_folder", "where")}


class Hasty(MonotonicClock):
    """A wait that returns at once."""

    def __init__(self):
        self._slept_ns = 0

    def now_ns(self):
        return super().now_ns() + self._slept_ns

    def sleep_until_ns(self, t_ns):
        self._slept_ns += max(0, t_ns - self.now_ns())


def on_ports(item):
    """A kind of devices, of which discovery asks serial ports only."""
    name, kind = item
    return name, replace(kind, models=tuple(replace(model, search=None) for model in kind.models))


COMMANDS = dict(leaves())
CASES = [
    pytest.param(words, parameter, id=f"{'-'.join(words)}.{parameter.name}")
    for words, command in COMMANDS.items()
    for parameter in command.params
    if not getattr(parameter, "is_flag", False)
]


def call(*arguments):
    """Exit code, standard output and messages of a call in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(a) for a in arguments])
    return code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """One good file of every kind that a command reads, and some that nothing can read."""
    folder = tmp_path_factory.mktemp("world")
    (folder / "idle.py").write_text(SCRIPT)
    with open_bench("emulated_floor") as bench:
        bench.add_sink(McapRecorder(folder / "run.mcap", bench.header(), lossless=True))
        bench.observe(1.5, feedback="odometry")
    assert call("demo-data", folder / "data", "--repetitions", "1")[0] == 0
    assert call("calibrate", folder / "data", "--no-validation", "--out", folder / "cal.toml")[0] == 0
    assert call("run", folder / "idle.py", "--out", folder / "results")[0] == 0
    for name in ("record", "other_record"):
        RobotRecord(folder / name).add({"zeros": ZEROS}, ROBOT, created=ZEROS.part.measured, why="a test")
    (folder / "empty").write_bytes(b"")
    (folder / "junk").write_bytes(bytes(range(256)) * 8)
    (folder / "taken").write_text("a file of the user's")
    (folder / "a_folder").mkdir()
    (folder / "taken_folder").mkdir()
    return folder


@pytest.fixture
def base(world, tmp_path, monkeypatch):
    """Good values for what a command needs, by its name; a new command gets names of nothing."""
    monkeypatch.chdir(tmp_path)

    def no_stages(self):
        raise DeviceError("the robot", "is not commissioned in this test")

    monkeypatch.setattr("hil.commission.run._Running.all", no_stages)

    monkeypatch.setattr("hil.commission.acceptance._Running.all", no_stages)

    def no_run(cell, bench):
        return lost(cell, "is not run in this test")

    monkeypatch.setattr("hil.fault_matrix.run_cell", no_run)

    def nothing(config, *, seed, faults):
        open_emulation(config, seed=seed, faults=faults).close()
        raise DeviceError("the world", "is not opened in this test")

    monkeypatch.setattr("hil.bench.opening.EmulatorProcess", nothing)
    monkeypatch.setattr("hil.cli.emulate._PATIENCE_S", 0.0)
    monkeypatch.setattr(
        "hil.cli.emulate._as_prompt_as_hardware", lambda fifo_priority: contextlib.nullcontext()
    )
    monkeypatch.setattr("hil.fakes.server.EmulationServer.run", lambda self, **_: self.close())
    monkeypatch.setattr("hil.bench.doctor.discovery.serial_ports", list)
    monkeypatch.setattr("hil.bench.doctor.discovery.kinds", lambda: dict(map(on_ports, kinds().items())))
    monkeypatch.setattr("hil.core.clock.MonotonicClock", Hasty)
    return {
        "run": {"script": world / "idle.py"},
        "campaign": {"script": world / "idle.py", "seeds": "0", "workers": "0"},
        "report": {"folders": world / "results"},
        "console": {"--stop": "", "where": world},
        "results list": {"where": world},
        "results trends": {"where": world, "out": tmp_path / "trends.html"},
        "live": {"duration_s": "0.2"},
        "replay": {"recording": world / "run.mcap", "estimators": "odometry"},
        "emulate": {"only": "imu"},
        "discover": {"ports": "absent"},
        "doctor": {"bench": "sensors", "emulate": "all", "watch_s": "0.1"},
        "setup": {"port": "absent", "servo_id": "1"},
        "evaluate": {"data": world / "data"},
        "calibrate": {"data": world / "data", "--no-validation": ""},
        "calibration list": {"file": world / "cal.toml"},
        "calibration apply": {"file": world / "cal.toml", "version": "1"},
        "calibration rollback": {"file": world / "cal.toml"},
        "robot show": {"record": world / "record"},
        "results open": {"where": world},
        "results search": {"where": world, "words": "idle"},
        "robot diff": {"record": world / "record"},
        "robot rollback": {"record": world / "record"},
        "robot apply": {
            "record": world / "record",
            "source": world / "other_record",
            "bench": "emulated_floor",
        },
        "tune": {"recordings": world / "run.mcap", "evaluations": "2"},
        "demo-data": {"folder": tmp_path / "made", "repetitions": "1"},
        "export": {"recording": world / "run.mcap"},
        "faults": {"--quick": "", "workers": "0"},
    }


def line(command, values):
    """The arguments of a call with these values by parameter name."""
    options, places = [], []
    for parameter in command.params:
        value = values.get(parameter.name)
        if value is None and parameter.required:
            value = "1" if is_number(parameter) else "absent"
        if value is None:
            continue
        if isinstance(parameter, click.Argument):
            places.append(value)
        else:
            options += [parameter.opts[-1], value]
    return [*(k for k in values if k.startswith("--")), *options, "--", *places]


def is_number(parameter):
    return isinstance(parameter.type, (click.types.IntParamType, click.types.FloatParamType))


def wrong_values(parameter, world):
    """(value, whether it must be refused) of one parameter."""
    if is_number(parameter):
        return [("many", True), ("", True), ("nan", True), ("inf", True), ("-3", False), ("9" * 30, False)]
    if isinstance(parameter.type, click.Choice):
        return [("nonsense", True), ("", True)]
    if isinstance(parameter.type, click.Path) or parameter.name in {"data", "script"}:
        below = world / "empty" / "below"
        if parameter.name in OUTPUTS:
            taken = [(world / "taken", False), (world / "taken_folder", False)]
            return [(below, True), (below / "deeper", True), ("/proc/absent/place", True), *taken]
        found = [
            (world / name, (name, parameter.name) not in EMPTY_IS_FINE)
            for name in ("absent.toml", "absent", "a_folder", "junk")
        ]
        for suffix in (".toml", ".csv", ".mcap", ".py", ".json", ".db3"):
            for kind in ("empty", "junk"):
                path = world / f"{kind}{suffix}"
                path.write_bytes((world / kind).read_bytes())
                found.append((path, (kind, parameter.name) not in EMPTY_IS_FINE))
        return [*found, (below, True)]
    return [
        ("", False),
        ("nonsense", False),
        ("a=b", False),
        (":,@+", False),
        (str(world / "junk.toml"), False),
    ]


@pytest.mark.parametrize(("words", "parameter"), every(6, CASES))
def test_a_wrong_value_is_answered_with_a_code_and_its_name(words, parameter, world, base):
    command, good = COMMANDS[words], base.get(" ".join(words), {})
    wrong_answers = []
    for value, refused in wrong_values(parameter, world):
        code, _, said = call(*words, *line(command, {**good, parameter.name: value}))
        names = (str(value), parameter.name, *parameter.opts)
        reported = code in (2, 3) and any(n and n.lower() in said.lower() for n in names)
        if code not in (0, 1, 2, 3, 4) or "Traceback" in said or (refused and not reported):
            wrong_answers.append((str(value), code, said[-300:]))
    assert wrong_answers == []
