"""A mistyped word on the command line is refused before anything is opened, with the word that was meant."""

import json

import pytest

from hil.cli import main


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


@pytest.mark.parametrize(
    "command", ["run bring_up", "campaign bring_up", "live --duration 1", "doctor", "emulate"]
)
def test_a_mistyped_fault_is_refused_by_every_command_that_opens_a_bench(refused, unopened, command):
    assert "did you mean imu?" in refused(*command.split(), "--fault", "imo:stuck")


@pytest.mark.parametrize(
    ("spec", "meant"),
    [
        ("imu:bus_off", "bus_off"),
        ("servo.drive_fl:off", "servo.drive_FL"),
        ("imu:wrong,rate_rads=1", "rate_rad_s"),
        ("tracker:wrong,scale=nan", "scale"),
        ("servos:brownout@1+-2", "-2 s"),
    ],
)
def test_a_mistyped_fault_is_refused_before_anything_is_opened(refused, unopened, spec, meant):
    assert meant in refused("run", "bring_up", "--fault", spec)


@pytest.mark.parametrize(
    ("rows", "reported"),
    [
        ("0,0,0\n0,0,0\n", "line 3"),
        ("0,0,0\n90,0,0\n", "x on the wall"),
        ("\n".join(f"{k % 2},0,0" for k in range(200_000)), "10000"),
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


@pytest.mark.parametrize("declared", ["parameters=int", 'measurements={"end": "mm"}', 'measurements=["end"]'])
def test_a_declaration_that_means_nothing_is_refused_by_its_file(
    refused, unopened, tmp_path_factory, declared
):
    path = tmp_path_factory.mktemp("given") / "mine.py"
    path.write_text(
        "from hil.procedure import procedure\n\n"
        f'@procedure(name="mine", {declared})\ndef run(ctx):\n    pass\n'
    )
    assert str(path) in refused("run", path)


def test_a_fault_for_a_device_that_is_not_served_is_refused(refused, unopened):
    assert "no emulated device" in refused("emulate", "--only", "imu", "--fault", "tracker:off")


@pytest.mark.parametrize(
    ("command", "target"),
    [("live --duration 1", "spwn"), ("live --duration 1", ","), ("replay recording.mcap", "film.rdd")],
)
def test_a_mistyped_view_is_refused_and_no_file_of_that_name_is_written(refused, unopened, command, target):
    assert f"'{target}'" in refused(*command.split(), "--rerun", target)


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["rn"], "run"),
        (["calibration", "rolback", "x"], "rollback"),
        (["run", "brng_up"], "bring_up"),
        (["run", "bring_up", "--emulate", "imo"], "imu"),
        (["run", "bring_up", "--set", "watch=1"], "watch_s"),
    ],
)
def test_a_mistyped_name_is_answered_with_the_nearest(refused, arguments, meant):
    assert f"did you mean {meant}?" in refused(*arguments)


DATA = {
    "test_gap.py": "def test_gap(bench):\n    pass\n",
    "gap.py": "from hil.procedure import procedure\n\n\n@procedure(name='gap')\ndef run(ctx):\n    pass\n",
    "lab.toml": 'schema = 1\nname = "lab"\n',
    "recording.mcap": "",
    "out/gap/one/result.json": "{}",
}


def left_in(folder):
    """All files; Python may keep the code of a script that it has read."""
    return sorted(path for path in folder.rglob("*") if "__pycache__" not in path.parts)


@pytest.mark.parametrize(
    ("command", "meant"),
    [
        ("run test_gap.py", "python -m pytest test_gap.py"),
        ("run recording.mcap", "hil replay recording.mcap"),
        ("run gp.py", "did you mean gap.py?"),
        ("report out", "hil report out/gap/one"),
        ("report gap.py", "hil run gap.py"),
        ("replay gap.py", "hil run gap.py"),
        ("doctor lab.toml", "--bench lab.toml"),
        ("run gap.py --set width=3", "width"),
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


@pytest.mark.parametrize("command", ["run bring_up", "faults", "calibrate data"])
def test_an_empty_name_is_no_place_for_results(refused, command):
    """As of a shell variable that is not set; results had gone to the folder that one was in."""
    assert "'--out'" in refused(*command.split(), "--out", "")


def test_the_page_of_one_run_is_written_where_it_is_wanted(tmp_path, capsys):
    folder, page = tmp_path / "run", tmp_path / "page.html"
    folder.mkdir()
    tree = {"schema": 1, "procedure": "shown", "verdict": "PASS", "measurements": []}
    (folder / "result.json").write_text(json.dumps(tree))
    assert main(["report", str(folder), "--out", str(page), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"] == str(page)
    assert "shown" in page.read_text(encoding="utf-8")
    assert [p.name for p in folder.iterdir()] == ["result.json"]
