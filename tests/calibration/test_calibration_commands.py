"""`hil evaluate`, `hil calibrate`, `hil demo-data` as a user calls them."""

import json

import pytest

from hil.calibration.artefact import read_calibration
from hil.cli import main
from hil.errors import ConfigError


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
    code, result = run_json(
        capsys, "calibrate", data, "--method", "lm", "--out", out, "--plots", tmp_path / "p"
    )
    assert code == 0
    assert result["cost_after"] < 0.1 * result["cost_before"]
    for key in ("method", "model", "signal", "std", "at_bound", "unobservable", "evaluations", "wall_s"):
        assert key in result
    assert {k: len(v) for k, v in result["parameters"].items()} == {
        "x_w_m": 4, "y_w_m": 4, "r_m": 4, "delta0_rad": 4,
    }  # fmt: skip
    page = (tmp_path / "p" / "index.html").read_text()
    assert "data:image/png;base64" in page
    assert "http" not in page.replace("http-equiv", "")
    _, before = run_json(capsys, "evaluate", data)
    _, after = run_json(capsys, "evaluate", data, "--calibration", out)
    _, twist = run_json(capsys, "evaluate", data, "--calibration", out, "--deploy", "twist")
    assert after["cost"] == pytest.approx(result["cost_after"], rel=1e-6)
    assert after["mean"]["rmse_position_m"] < 0.3 * before["mean"]["rmse_position_m"]
    assert twist["mean"]["rmse_position_m"] < 0.3 * before["mean"]["rmse_position_m"]
    assert set(before["motions"]["line_x"]) >= {"n", "e_x_m", "e_theta_a", "final_position_m"}


def test_a_calibration_is_never_overwritten(data, tmp_path):
    out = tmp_path / "calibration.toml"
    for version in (1, 2, 3):
        assert main(["calibrate", str(data), "--no-validation", "--out", str(out)]) == 0
        assert read_calibration(out).version == version
    assert read_calibration(tmp_path / "calibration.v1.toml").version == 1
    assert read_calibration(out).previous["file"] == "calibration.v2.toml"


@pytest.mark.parametrize("method", ["interior-point", "ga", "pso"])
def test_the_papers_setting_by_every_method(data, capsys, method):
    code, result = run_json(
        capsys, "calibrate", data, "--setting", "paper", "--method", method, "--no-validation"
    )
    assert (code, result["model"], result["signal"]) == (0, "paper", "velocity")
    assert result["polished"] == (method in ("ga", "pso"))
    assert result["determined_directions"] == 6


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["evaluate", "nowhere"], "nowhere: does not exist"),
        (["evaluate", "{data}", "--calibration", "nothing.toml"], "nothing.toml: cannot be read"),
        (["evaluate", "{data}", "--deploy", "twist"], "needs --calibration"),
        (["calibrate", "{data}", "--method", "magic"], "magic"),
        (["calibrate", "{data}", "--bounds", "-1"], "bounds"),
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
