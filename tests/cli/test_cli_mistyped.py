"""A mistyped word on the command line is refused before anything is opened, with the word that was meant."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from hil.bench import check_faults
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import FaultNotSupportedError

OPENING = [
    "run bring_up",
    "run bring_up --dry-run",
    "campaign bring_up",
    "live --duration 1",
    "doctor",
    "doctor --realtime",
    "emulate",
]


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Runs a command that must be refused as a usage error without leaving anything; gives its message."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        assert main([str(a) for a in arguments]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert list(tmp_path.iterdir()) == []
        return said.err

    return call


@pytest.fixture
def unopened(monkeypatch):
    """No device, wire or process may be opened."""

    def opened(*_, **__):
        raise AssertionError("the bench was opened")

    monkeypatch.setattr("hil.loop.device_set.DeviceSet.open", opened)
    monkeypatch.setattr("hil.bench.opening.EmulatorProcess", opened)
    monkeypatch.setattr("hil.fakes.server.EmulationServer.run", opened)


@pytest.mark.parametrize("command", OPENING)
def test_a_mistyped_fault_is_refused_by_every_command_that_opens_a_bench(refused, unopened, command):
    assert "did you mean imu?" in refused(*command.split(), "--fault", "imo:stuck")


@pytest.mark.parametrize(
    ("spec", "meant"),
    [
        ("imu:stukc", "did you mean stuck?"),
        ("imu:bus_off", "imu cannot produce"),
        ("servo.drive_fl:off", "did you mean servo.drive_FL?"),
        ("imu:wrong,rate_rads=1", "did you mean rate_rad_s?"),
        ("imu:stuck,scale=2", "expected no option"),
        ("tracker:wrong,scale=nan", "expected a number from -10 to 10"),
        ("servos:intermittent@1,period_s=0", "period_s is 0; expected a number from 0.001 to 3600"),
        ("imu:stuck@1e999", "a start >= 0"),
        ("servos:brownout@1+-2", "has start 1 s and duration -2 s; expected"),
    ],
)
def test_a_mistyped_fault_is_refused_before_anything_is_opened(refused, unopened, spec, meant):
    assert meant in refused("run", "bring_up", "--fault", spec)


@pytest.mark.parametrize(
    ("rows", "reported"),
    [
        ("0,0,0\n0,0,0\n", "line 3 repeats the waypoint before it"),
        ("0,0,0\n1e9,0,0\n", "line 3 holds 1e+09, 0, 0"),
        ("0,0,0\n90,0,0\n", "x on the wall (m) is 5.0003 at"),
        ("0,0,0\n0,0,1\n", "heading on the wall (rad)"),
        ("\n".join(f"{k % 2},0,0" for k in range(200_000)), "holds more than 10000 waypoints"),
    ],
)
def test_waypoints_that_cannot_be_driven_are_refused_before_the_bench_opens(
    refused, unopened, tmp_path_factory, rows, reported
):
    path = tmp_path_factory.mktemp("given") / "way.csv"
    path.write_text("x,y,theta\n" + rows)
    said = refused("live", "--trajectory", path)
    assert reported in said
    assert str(path) in said


@pytest.mark.parametrize("way", [[], ["--dry-run"]])
@pytest.mark.parametrize(
    ("declared", "reported"),
    [
        (
            'parameters={"y": 0.0, "x": 0.2}',
            "parameters is a dict; expected a class: a dataclass, or a pydantic",
        ),
        ("parameters=int", "parameters is int; expected a class"),
        ('measurements={"end": "mm"}', "measurements is a dict; expected a list of Measurement(NAME, UNIT"),
        ('measurements=["end"]', "among the measurements is a str"),
    ],
)
def test_a_declaration_that_means_nothing_is_refused_by_its_file(
    refused, unopened, tmp_path_factory, way, declared, reported
):
    path = tmp_path_factory.mktemp("given") / "mine.py"
    path.write_text(
        "from hil.procedure import procedure\n\n"
        f'@procedure(name="mine", {declared})\ndef run(ctx):\n    pass\n'
    )
    said = refused("run", path, *way)
    assert reported in said
    assert str(path) in said


def test_a_fault_for_a_device_that_is_not_served_is_refused(refused, unopened):
    assert "no emulated device" in refused("emulate", "--only", "imu", "--fault", "tracker:off")


def test_faults_on_a_bench_without_emulated_devices_are_refused(tmp_path):
    bench = tmp_path / "real.toml"
    bench.write_text('schema = 1\nname = "real"\n[imu]\nport = "/dev/ttyUSB0"\n')
    with pytest.raises(FaultNotSupportedError, match="every device of real is real"):
        check_faults(load_bench(bench), ["imu:stuck"])


@pytest.mark.parametrize("target", ["spwn", "film.rdd", "spawn,serv", "film", ","])
@pytest.mark.parametrize("command", ["live --duration 1", "replay recording.mcap"])
def test_a_mistyped_view_is_refused_and_no_file_of_that_name_is_written(refused, unopened, command, target):
    said = refused(*command.split(), "--rerun", target)
    assert "spawn, connect, serve, a rerun+http:// URL or a .rrd file" in said
    if target in ("spwn", "spawn,serv"):
        assert "did you mean" in said


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["rn"], "run"),
        (["emulat"], "emulate"),
        (["calibration", "rolback", "x"], "rollback"),
        (["run", "brng_up"], "bring_up"),
        (["run", "bring_up", "--bench", "emulatd"], "emulated"),
        (["run", "bring_up", "--emulate", "imo"], "imu"),
        (["run", "bring_up", "--set", "watch=1"], "watch_s"),
        (["run", "bring_up", "--set", "bench.environmet.tilt_rad=0"], "environment"),
    ],
)
def test_a_mistyped_name_is_answered_with_the_nearest(refused, arguments, meant):
    assert f"did you mean {meant}?" in refused(*arguments)


@pytest.mark.parametrize("typed", ["short_lin", "short_lin.py", "shot_line.py:drive"])
def test_a_mistyped_script_is_answered_with_one_that_is_there(tmp_path, monkeypatch, capsys, typed):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short_line.py").touch()
    assert main(["run", typed]) == 2
    assert "did you mean short_line.py?" in capsys.readouterr().err


DATA = {
    "test_gap.py": "def test_gap(bench):\n    pass\n",
    "gap.py": "from hil.procedure import procedure\n\n\n@procedure(name='gap')\ndef run(ctx):\n    pass\n",
    "lab.toml": 'schema = 1\nname = "lab"\n',
    "recording.mcap": "",
    "out/gap/one/result.json": "{}",
    "out/gap/one/report.html": "",
    "out/runs/campaign.json": "{}",
}


def left_in(folder):
    """All files; Python may keep the code of a script that it has read."""
    return sorted(path for path in folder.rglob("*") if "__pycache__" not in path.parts)


@pytest.mark.parametrize(
    ("command", "meant"),
    [
        (
            "run test_gap.py",
            "test_gap.py: holds no procedure; it is a file of tests: python -m pytest test_gap.py",
        ),
        ("run recording.mcap", "it is a recording: hil replay recording.mcap"),
        ("run out/gap/one", "hil report out/gap/one"),
        ("report out", "the latest: hil report out/gap/one; all: hil results list --in out"),
        ("report gap.py", "it is a script: hil run gap.py"),
        ("report out/gap/one/report.html", "it belongs to a run: hil report out/gap/one"),
        ("report out/runs", "it holds a campaign: open out/runs/campaign.html"),
        ("replay gap.py", "gap.py: is no recording; it is a script: hil run gap.py"),
        ("doctor --bench lab", "did you mean lab.toml?"),
        ("list fault", "did you mean faults?"),
        ("doctor lab.toml", "did you mean --bench lab.toml?"),
        ("run", "Example: hil run bring_up --quick --set watch_s=2"),
        ("run gap.py --seed many", "'many' is not a whole number."),
        ("run gap.py --set width=3", "width: unknown parameter; gap has no parameters"),
    ],
)
def test_what_is_for_another_command_is_answered_with_that_command(
    tmp_path, monkeypatch, capsys, command, meant
):
    monkeypatch.chdir(tmp_path)
    for name, text in DATA.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    before = left_in(tmp_path)
    assert main(command.split()) != 0
    said = capsys.readouterr()
    assert meant in " ".join(said.err.split())
    assert (said.out, left_in(tmp_path)) == ("", before)


def test_python_m_hil_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "hil", "--version"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("hil, version ")


def test_the_page_of_one_run_is_written_where_it_is_wanted(tmp_path):
    folder, page = tmp_path / "run", tmp_path / "page.html"
    folder.mkdir()
    tree = {"schema": 1, "procedure": "shown", "verdict": "PASS", "measurements": []}
    (folder / "result.json").write_text(json.dumps(tree))
    done = CliRunner().invoke(main_of("report"), [str(folder), "--out", str(page), "--json"])
    assert json.loads(done.stdout)["report"] == str(page)
    assert "shown" in page.read_text(encoding="utf-8")
    assert [p.name for p in folder.iterdir()] == ["result.json"]


def main_of(name):
    from hil.cli import cli

    return cli.get_command(None, name)


@pytest.mark.parametrize(
    "command", ["run bring_up", "campaign bring_up", "faults", "accept", "calibrate data", "tune data"]
)
def test_an_empty_name_is_no_place_for_results(refused, command):
    """As of a shell variable that is not set; results had gone to the folder that one was in."""
    said = refused(*command.split(), "--out", "")
    assert "'--out'" in said
    assert "the name is empty" in said
