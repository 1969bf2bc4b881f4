"""`hil evaluate`, `hil calibrate`, `hil demo-data` as a user calls them."""

import json
import os
import re
import shutil

import numpy as np
import pytest

from hil.calibration.calibration_file import read_calibration
from hil.cli import main
from hil.core.errors import ConfigError
from hil.core.signals import WHEELS


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    assert main(["demo-data", str(folder), "--repetitions", "2", "--seed", "5"]) == 0
    return folder


def run_json(capsys, *args):
    capsys.readouterr()
    code = main([*map(str, args), "--json"])
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    return code, json.loads(out)


def test_calibrate_then_evaluate_with_the_file(data, tmp_path, capsys):
    out = tmp_path / "calibration.toml"
    words = ["--no-validation", "--model", "exact", "--out", out, "--plots", tmp_path / "p"]
    code, result = run_json(capsys, "calibrate", data, *words)
    assert code == 0
    assert result["cost_after"] < 0.1 * result["cost_before"]
    for key in ("method", "model", "signal", "std", "at_bound", "unobservable", "evaluations", "wall_s"):
        assert key in result
    assert {k: len(v) for k, v in result["parameters"].items()} == {
        "x_w_m": 4,
        "y_w_m": 4,
        "r_m": 4,
        "delta0_rad": 4,
    }
    named = [*result["unobservable"], *re.findall(r"[a-z]\w*_\w+", " ".join(result["directions"]))]
    assert named
    assert {name.rpartition("_")[2] for name in named} <= set(WHEELS), "wheels have one set of names"
    page = (tmp_path / "p" / "index.html").read_text()
    assert "data:image/svg+xml;base64" in page
    assert "http" not in page.replace("http-equiv", "")
    _, before = run_json(capsys, "evaluate", data)
    _, after = run_json(capsys, "evaluate", data, "--calibration", out)
    _, twist = run_json(capsys, "evaluate", data, "--calibration", out, "--deploy", "twist")
    assert after["cost"] == pytest.approx(result["cost_after"], rel=1e-6)
    assert after["mean"]["rmse_position_m"] < 0.3 * before["mean"]["rmse_position_m"]
    assert twist["mean"]["rmse_position_m"] < 0.3 * before["mean"]["rmse_position_m"]
    assert set(before["motions"]["line_x"]) >= {"n", "e_x_m", "e_theta_a", "final_position_m"}


@pytest.fixture(scope="module")
def fitted_to_some(data, tmp_path_factory):
    """A calibration by the first repetitions of all."""
    out = tmp_path_factory.mktemp("fitted") / "calibration.toml"
    runs = [str(path) for path in sorted(data.glob("*_1.csv"))]
    assert main(["calibrate", *runs, "--no-validation", "--model", "exact", "--out", str(out)]) == 0
    return out


def test_recordings_that_a_calibration_was_fitted_to_are_in_sample_by_any_name(
    data, fitted_to_some, tmp_path, capsys
):
    def evaluated(*args):
        return run_json(capsys, "evaluate", *args, "--calibration", fitted_to_some)[1]["in_sample"]

    seen = sorted(p.stem for p in data.glob("*_1.csv"))
    assert evaluated(data) == {"count": 6, "of": 12, "names": seen}
    assert evaluated(*sorted(data.glob("*_2.csv"))) == {"count": 0, "of": 6, "names": []}
    shutil.copy(data / "line_x_1.csv", tmp_path / "line_x_9.csv")
    assert evaluated(tmp_path / "line_x_9.csv")["names"] == ["line_x_9"]
    assert run_json(capsys, "evaluate", data)[1].get("in_sample") is None


def test_a_file_of_other_bytes_is_in_sample_by_its_wheels(data, fitted_to_some, tmp_path, capsys):
    for day, first in (("monday", "line_x_1"), ("tuesday", "line_x_2")):
        (tmp_path / day).mkdir()
        content = (data / f"{first}.csv").read_bytes()
        (tmp_path / day / "line_x_1.csv").write_bytes(content.replace(b"\r\n", b"\n"))
    words = [tmp_path / "monday", tmp_path / "tuesday", "--calibration", fitted_to_some]
    assert run_json(capsys, "evaluate", *words)[1]["in_sample"]["names"] == ["monday/line_x_1"]


def test_a_calibration_that_names_no_files_says_neither(data, fitted_to_some, tmp_path, capsys):
    nameless = tmp_path / "calibration.toml"
    nameless.write_text(re.sub(r"(sha256|wheels) = \[[^]]*\]", r"\1 = []", fitted_to_some.read_text()))
    _, table = run_json(capsys, "evaluate", data, "--calibration", nameless)
    assert table["in_sample"]["count"] is None


def test_another_model_or_signal_than_the_calibrations_is_warned_of(data, fitted_to_some, capsys):
    def warned(*args):
        _, table = run_json(capsys, "evaluate", data, "--calibration", fitted_to_some, *args)
        assert table["fitted_with"] == {"model": "exact", "signal": "position"}
        return [w for w in table["warnings"] if w.startswith("--")], table

    none, own = warned()
    assert none == []
    assert (own["model"], own["signal"], own["deploy"]) == ("exact", "position", "parameters")
    assert warned("--model", "exact", "--signal", "position")[0] == []
    ((model,), other), ((signal,), _) = warned("--model", "dry-friction"), warned("--signal", "velocity")
    assert model.startswith("--model dry-friction: the calibration was fitted with the model exact")
    assert signal.startswith("--signal velocity: the calibration was fitted with the signal position")
    assert other["model"] == "dry-friction"
    (twist,), table = warned("--deploy", "twist", "--model", "dry-friction")
    assert twist.startswith("--model dry-friction has no effect with --deploy twist")
    assert table["model"] == "exact"


def test_a_calibration_is_never_overwritten(data, tmp_path):
    out, runs = tmp_path / "calibration.toml", [str(data / "line_x_1.csv"), str(data / "circle_cw_1.csv")]
    for version in (1, 2, 3):
        assert main(["calibrate", *runs, "--no-validation", "--model", "exact", "--out", str(out)]) == 0
        assert read_calibration(out).version == version
    assert read_calibration(tmp_path / "calibration.v1.toml").version == 1
    assert read_calibration(out).previous["file"] == "calibration.v2.toml"


def test_the_papers_setting_by_another_method(data, capsys):
    words = ["--setting", "paper", "--method", "interior-point", "--no-validation"]
    code, result = run_json(capsys, "calibrate", data, *words)
    assert (code, result["model"], result["signal"]) == (0, "paper", "velocity")
    assert not result["polished"]
    assert result["determined_directions"] == 6


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["evaluate", "nowhere"], "nowhere: does not exist"),
        (["evaluate", "{data}", "--deploy", "twist"], "needs --calibration"),
        (["calibrate", "{data}", "--method", "magic"], "magic"),
        (["demo-data", "{data}", "--corrupt", "tango_1"], "no such recording"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(data, capsys, args, message):
    assert main([a.format(data=data) for a in args]) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""


def test_a_spoiled_calibration_file_lists_every_problem(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text('schema = 2\nmethod = "lm"\nwhim = 1\n')
    with pytest.raises(ConfigError) as error:
        read_calibration(path)
    assert len(error.value.problems) > 5
    path.write_text("schema = ")
    with pytest.raises(ConfigError, match="not valid TOML"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("command", "key"),
    [(("evaluate",), "cost"), (("calibrate", "--no-validation", "--model", "exact"), "cost_after")],
)
def test_files_given_twice_and_copies_count_once_and_are_named(data, tmp_path, capsys, command, key):
    path, (link, copy) = data / "line_x_1.csv", (tmp_path / name for name in ("link_1.csv", "line_x_3.csv"))
    link.symlink_to(path)
    shutil.copy(path, copy)
    _, once = run_json(capsys, *command, data)
    code, more = run_json(capsys, *command, data, path, data, tmp_path)
    assert (code, more["recordings"], more[key]) == (0, once["recordings"], once[key])
    assert f"line_x_1: 3 mentions of {path} beyond the first left out" in more["warnings"]
    assert sum("beyond the first" in line for line in more["warnings"]) == once["recordings"]
    assert f"line_x_1: 1 copy of it left out, {copy}" in more["warnings"]


@pytest.mark.parametrize(
    ("content", "said"), [("# nothing\n", "is empty"), ('schema = 1\nname = "lab"\n', "is no")]
)
def test_what_is_no_calibration_file_is_reported_in_one_line(data, tmp_path, capsys, content, said):
    path = tmp_path / "c.toml"
    path.write_text(content)
    assert main(["evaluate", str(data), "--calibration", str(path)]) == 2
    reported = capsys.readouterr().err
    assert f"{path}: {said}" in reported
    assert reported.count("\n") == 1


def test_one_recording_has_no_standard_errors(data, capsys):
    words = ["calibrate", str(data / "circle_cw_1.csv"), "--no-validation", "--model", "exact"]
    assert main(words) == 0
    reported = capsys.readouterr().out
    assert "no standard errors from one recording" in reported
    assert "nan" not in reported
    code, found = run_json(capsys, *words)
    assert (code, found["std"]["r_m"]) == (0, [None] * 4)


BENCH = """
schema = 1
name = "small"
[environment]
surface = "floor"
tilt_rad = 0.0
[robot]
wheel_x_m = [0.1, -0.1, -0.1, 0.1]
wheel_y_m = [0.075, 0.075, -0.075, -0.075]
wheel_radius_m = [0.04, 0.04, 0.04, 0.04]
centre_of_mass_m = [-0.02, 0.0, 0.05]
[control]
steering_limit_rad = 1.7
"""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Bench file and generated data of a robot of other proportions."""
    folder = tmp_path_factory.mktemp("small")
    (folder / "bench.toml").write_text(BENCH)
    words = ["--bench", str(folder / "bench.toml"), "--seed", "2", "--repetitions", "2"]
    assert main(["demo-data", str(folder / "data"), *words]) == 0
    return folder / "bench.toml", folder / "data"


def test_a_robot_of_other_proportions_is_calibrated_with_its_bench_file(small, tmp_path, capsys):
    bench, data = small
    truth = json.loads((data / "truth.json").read_text())
    assert np.allclose(truth["r_m"], 0.04, rtol=0.03)
    out = tmp_path / "c.toml"
    code, found = run_json(capsys, "calibrate", data, "--bench", bench, "--out", out, "--model", "exact")
    assert code == 0
    assert found["geometry"]["source"] == "bench small"
    assert found["geometry"]["x_w_m"] == [0.1, -0.1, -0.1, 0.1]
    assert found["geometry"]["steering_limit_rad"] == 1.7
    assert found["geometry"]["load"][1] > 1.1 > 0.9 > found["geometry"]["load"][0]
    assert not found["at_bound"]
    tables = found["validation"]
    held_out = tables["leave_one_repetition_out"]["mean"]["rmse_position_m"]
    assert held_out < 4e-3 < 0.15 * tables["nominal"]["mean"]["rmse_position_m"]
    assert np.mean(found["parameters"]["r_m"]) == pytest.approx(np.mean(truth["r_m"]), rel=2e-3)
    _, nominal = run_json(capsys, "evaluate", data, "--bench", bench)
    _, after = run_json(capsys, "evaluate", data, "--bench", bench, "--calibration", out)
    assert nominal["geometry"]["r_m"] == [0.04] * 4
    assert after["mean"]["rmse_position_m"] < 0.15 * nominal["mean"]["rmse_position_m"]
    assert read_calibration(out).nominal.r_m == (0.04,) * 4


def test_without_the_bench_file_another_robot_is_distinguished(small, tmp_path, capsys):
    _, data = small
    assert main(["calibrate", str(data)]) == 2
    reported = capsys.readouterr().err
    assert "the geometry does not fit the recordings" in reported
    assert "--bench" in reported
    assert "built-in CAD" in reported
    code, table = run_json(capsys, "evaluate", data)
    assert code == 2
    assert any("--bench" in line for line in table["warnings"])
    assert table["geometry"]["source"].startswith("built-in CAD")


def test_a_calibration_of_another_robot_is_refused_beside_its_bench(small, data, tmp_path, capsys):
    out = tmp_path / "ours.toml"
    assert main(["calibrate", str(data), "--no-validation", "--out", str(out)]) == 0
    assert main(["evaluate", str(data), "--calibration", str(out), "--bench", str(small[0])]) == 2
    assert "made for another robot" in capsys.readouterr().err


@pytest.mark.long
def test_evaluation_says_where_a_twist_loses(tmp_path, capsys):
    folder, out = tmp_path / "d", tmp_path / "c.toml"
    args = ["--contact", "coulomb", "--seed", "3", "--repetitions", "2"]
    assert main(["demo-data", str(folder), *args]) == 0
    assert (
        main(["calibrate", str(folder), "--model", "dry-friction", "--no-validation", "--out", str(out)]) == 0
    )
    assert "with --deploy twist errors grow" in capsys.readouterr().err
    _, twist = run_json(capsys, "evaluate", folder, "--calibration", out, "--deploy", "twist")
    assert any("with --deploy twist errors grow" in line for line in twist["warnings"])
    _, plain = run_json(capsys, "evaluate", folder, "--calibration", out)
    assert not any("--deploy twist" in line for line in plain["warnings"])


BAD_FOLDERS = ("file", "file/below", "{proc}/folder")


def outputs(data):
    calibrate = ["calibrate", str(data), "--no-validation"]
    return {
        "demo-data": (["demo-data"], "", BAD_FOLDERS),
        "evaluate --plots": (["evaluate", str(data)], "--plots", BAD_FOLDERS),
        "calibrate --plots": (calibrate, "--plots", BAD_FOLDERS),
        "calibrate --out": (calibrate, "--out", ("folder", "file/c.toml", "{proc}/c.toml", "file")),
        "tune --out": (["tune", "nothing.mcap"], "--out", ("folder", "file/e.toml", "{proc}/e.toml")),
    }


@pytest.mark.parametrize(
    "command", ["demo-data", "evaluate --plots", "calibrate --plots", "calibrate --out", "tune --out"]
)
def test_what_cannot_be_written_is_named_before_the_work(data, tmp_path, capsys, monkeypatch, command):
    """On a file, below a file, without write access: exit 2, the path, no traceback, nothing left."""
    words, option, targets = outputs(data)[command]
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("kept")
    worked = []
    monkeypatch.setattr("hil.datasets.read.read_recordings", lambda *a, **k: worked.append(a))
    monkeypatch.setattr("hil.calibration.synthetic.make_set", lambda *a, **k: worked.append(a))
    for target in targets:
        path = target.format(proc="/proc/self") if "{" in target else str(tmp_path / target)
        capsys.readouterr()
        assert main([*words, *([option] if option else []), path]) == 2, target
        reported = capsys.readouterr()
        assert path in reported.err
        assert "Traceback" not in reported.err
        assert reported.out == ""
    assert worked == []
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "kept"


def test_nothing_is_half_written(tmp_path, capsys, monkeypatch):
    """The room runs out after three recordings: what was there stays, nothing new appears."""
    import hil.procedure.odometry_motions  # noqa: F401  binds it at import: not while it is another one
    from hil.datasets import plain_csv

    real, written = plain_csv.write_plain, []

    def write(path, recording):
        if len(written) == 3:
            raise OSError(28, "No space left on device")
        written.append(path)
        real(path, recording)

    monkeypatch.setattr(plain_csv, "write_plain", write)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "mine.txt").write_text("kept")
    for folder, left in (("new", None), ("old", ["mine.txt"])):
        written.clear()
        assert main(["demo-data", str(tmp_path / folder), "--repetitions", "1"]) == 2
        reported = capsys.readouterr().err
        assert f"{tmp_path / folder}: cannot be written (No space left on device)" in reported
        assert not (tmp_path / folder).exists() if left is None else os.listdir(tmp_path / folder) == left


def held(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


SMALL_SET = ("--motions", "line_x,line_y", "--repetitions", "1")


@pytest.mark.parametrize("name", ["line_x_1.csv", "run.mcap", "truth.json"])
def test_generated_recordings_neither_replace_nor_join_those_of_a_user(tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    assert main(["demo-data", str(tmp_path), *SMALL_SET]) == 2
    reported = capsys.readouterr()
    assert reported.out == ""
    assert f"{tmp_path}: holds {name}, which" in reported.err
    assert "choose another folder" in reported.err
    assert held(tmp_path) == {name: b"mine"}


@pytest.mark.parametrize("other", [("--seed", "1"), ("--plant", "own")])
def test_two_robots_are_never_in_one_folder_of_generated_recordings(tmp_path, capsys, other):
    assert main(["demo-data", str(tmp_path), *SMALL_SET]) == 0
    before = held(tmp_path)
    assert main(["demo-data", str(tmp_path), *SMALL_SET, *other]) == 2
    assert f"{tmp_path}: holds line_" in capsys.readouterr().err
    assert held(tmp_path) == before


def test_the_same_recordings_may_be_generated_again_beside_other_files(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for _ in range(2):
        assert main(["demo-data", str(tmp_path), *SMALL_SET]) == 0
    assert set(held(tmp_path)) == {"notes.txt", "line_x_1.csv", "line_y_1.csv", "truth.json"}
