"""A calibration that failed its validation run is refused, or named wherever its figures are shown."""

import json
from importlib import resources

import pytest
from made_calibrations import made

from hil.bench import open_bench
from hil.calibration.versions import CalibrationVersions
from hil.cli import main
from hil.config.loading import load_bench
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import line

FLOOR = resources.files("hil.config.profiles").joinpath("emulated_floor.toml")


@pytest.fixture
def versions(tmp_path):
    return CalibrationVersions(tmp_path / "calibration.toml")


STANDS = """
from hil.procedure import procedure

@procedure(name="stands", needs=("servos",))
def run(ctx):
    ctx.bench.observe(0.1, feedback="odometry")
"""


def test_a_run_that_was_to_use_a_failed_calibration_says_so(versions, tmp_path, caplog):
    failed = versions.add(made(0.0252, "FAIL"))
    (tmp_path / "stands.py").write_text(STANDS)
    reported = {}
    for verdict, path in (("FAIL", failed.path), ("PASS", versions.add(made(0.0252)).path)):
        out = tmp_path / verdict
        caplog.clear()
        words = ["run", tmp_path / "stands.py", "--bench", "emulated_floor", "--out", out]
        words += ["--calibration", path, "--set", "bench.failed_calibration=true"]
        assert main([*map(str, words)]) == 0
        result = json.loads((out / "result.json").read_text())
        assert result["calibration"]["verdict"] == verdict
        reported[verdict] = [
            "verdict FAIL" in " ".join(result["notes"]),
            "verdict FAIL" in (out / "report.html").read_text(),
            "verdict FAIL" in caplog.text,
        ]
    assert reported == {"FAIL": [True] * 3, "PASS": [False] * 3}


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """A recording of the bench, and another's as a table."""
    folder = tmp_path_factory.mktemp("drives")
    ours = folder / "ours.mcap"
    bench = open_bench("emulated_floor", seed=3)
    bench.add_sink(McapRecorder(ours, bench.header(), lossless=True))
    with bench:
        bench.drive(line((0.0, 0.0, 0.0), (0.05, 0.0, 0.0)))
    assert main(["export", str(ours), "--out", str(folder / "line_x_1.csv")]) == 0
    return ours, folder / "line_x_1.csv"


@pytest.mark.parametrize(("command", "which"), [("evaluate", 1), ("replay", 0)])
def test_who_compares_with_a_failed_calibration_is_reported(
    versions, drives, command, which, tmp_path, capsys
):
    failed, good = versions.add(made(0.0257, "FAIL")), versions.add(made(0.0257))
    page = {"evaluate": ["--plots", tmp_path], "replay": ["--page", tmp_path / "index.html"]}[command]
    reported = []
    for kept in (failed, good):
        words = [command, drives[which], "--calibration", kept.path, *page, "--json"]
        assert main([*map(str, words)]) == 0
        said = capsys.readouterr()
        warnings = json.loads(said.out)["warnings"]
        shown = (tmp_path / "index.html").read_text()
        reported.append(["verdict FAIL" in text for text in (said.err, " ".join(warnings), shown)])
    assert reported == [[True] * 3, [False] * 3]


def test_figures_for_a_bench_are_not_tuned_with_a_failed_calibration(versions, drives, tmp_path, capsys):
    failed, asks = versions.add(made(0.0257, "FAIL")), tmp_path / "bench.toml"
    asks.write_text("failed_calibration = true\n" + FLOOR.read_text())
    words = [
        "tune",
        drives[0],
        "--evaluations",
        "2",
        "--parameter",
        "wheels.step_m",
        "--calibration",
        failed.path,
    ]
    assert main([*map(str, words)]) == 2
    said = capsys.readouterr().err
    assert str(failed.path) in said
    assert "failed_calibration" in said
    assert main([*map(str, words), "--bench", str(asks)]) == 0


@pytest.mark.parametrize("command", ["evaluate", "replay"])
def test_a_calibration_of_another_robot_is_not_compared_with(versions, drives, command, capsys):
    other = load_bench("emulated_floor", overrides={"servos.steer_ids": [15, 16, 17, 18]})
    kept = versions.add(made(config=other))
    bench = ["--bench", "emulated_floor"] if command == "evaluate" else []
    assert main([command, str(drives[0]), "--calibration", str(kept.path), *bench]) == 2
    assert "servos.steer_ids" in capsys.readouterr().err
