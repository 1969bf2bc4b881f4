"""A calibration whose numbers no robot can have is refused with file and key, before anything is opened."""

import json

import pytest
import tomli_w

from hil.calibration.calibration_file import CalibrationFile, read_calibration, save_calibration
from hil.calibration.parameters import SHARE
from hil.cli import main
from hil.core.errors import ConfigError

X, Y, R = (0.1125, -0.1125, -0.1125, 0.1125), (0.1125, 0.1125, -0.1125, -0.1125), (0.0254,) * 4
PAPER = {"x_w_m": X, "y_w_m": Y, "r_m": R}
ZEROS = (0.0,) * 4


def tree(**changes):
    return {
        "schema": 1,
        "version": 1,
        "created": "2026-01-01",
        "method": "lm",
        "setting": "all",
        "model": "creep",
        "signal": "position",
        "parameters": PAPER | {"delta0_rad": ZEROS},
        "nominal": PAPER,
        "std": {},
        "cost_before": 2.0,
        "cost_after": 1.0,
        "recordings": {},
        "twist_correction": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        "tyres": {"load": (1.0,) * 4, "creep_ratio": 0.7},
        **changes,
    }


def text(dotted, value):
    """The file with one number exchanged, as a hand or a disk would exchange it."""
    changed = json.loads(json.dumps(tree()))
    inner = changed
    *way, last = [int(k) if k.isdigit() else k for k in dotted.split(".")]
    for key in way:
        inner = inner[key]
    inner[last] = value
    return tomli_w.dumps(changed)


IMPOSSIBLE = [
    ("parameters.x_w_m.0", 1e9),
    ("parameters.x_w_m.0", -0.1117),
    ("parameters.y_w_m.3", float("nan")),
    ("parameters.y_w_m.1", 0.17),
    ("parameters.r_m.0", 0.0),
    ("parameters.r_m.3", 0.0254 * 1.3),
    ("parameters.delta0_rad.0", 1.6),
    ("parameters.delta0_rad.1", float("inf")),
    ("nominal.r_m.0", 0.0),
    ("nominal.delta0_rad", [9.0] * 4),
    ("twist_correction.0.0", float("nan")),
    ("twist_correction.1.1", 1e9),
    ("twist_correction.2.0", -1e3),
    ("tyres.load.2", -1.0),
    ("tyres.load", [0.0] * 4),
    ("tyres.creep_ratio", float("nan")),
]


@pytest.mark.parametrize(("key", "value"), IMPOSSIBLE)
def test_an_impossible_number_is_refused_with_file_and_key(tmp_path, key, value):
    path = tmp_path / "c.toml"
    path.write_text(text(key, value))
    with pytest.raises(ConfigError, match=r"c\.toml: no robot can be driven") as error:
        read_calibration(path)
    assert error.value.problems[0].startswith(key)
    assert "expected" in error.value.problems[0]


def test_another_order_of_the_wheels_is_refused_with_the_one_that_is_expected(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text(tomli_w.dumps(json.loads(json.dumps(tree(wheel_order="FR FL BL BR")))))
    with pytest.raises(
        ConfigError, match=r"c\.toml: wheel_order is 'FR FL BL BR'; expected 'FL BL BR FR'.*lists"
    ):
        read_calibration(path)


def test_all_impossible_numbers_are_named_at_once(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text(text("parameters", PAPER | {"x_w_m": [9.0] * 4, "r_m": [0.0] * 4}))
    with pytest.raises(ConfigError) as error:
        read_calibration(path)
    assert len(error.value.problems) == 8


def test_a_run_ends_before_the_bench_is_opened(tmp_path, capsys):
    path = tmp_path / "c.toml"
    path.write_text(text("parameters.x_w_m.0", -0.1117))
    out = tmp_path / "out"
    assert main(["run", "latency", "--calibration", str(path), "--out", str(out), "--json"]) == 2
    assert "c.toml" in (reported := capsys.readouterr().err)
    assert "parameters.x_w_m.0: -0.1117 m" in reported
    assert not out.exists()


def test_what_the_fit_may_find_is_taken(tmp_path):
    """A wheel on every bound that `--bounds` permits, and a column that no recording has driven."""
    most = 1.0 + SHARE
    found = {
        "x_w_m": [most * x for x in X],
        "y_w_m": [y / most for y in Y],
        "r_m": [most * r for r in R],
        "delta0_rad": [SHARE, -SHARE, 0.0, 0.0],
    }
    twist = ((1.01, 0.0, -0.03), (0.0, 0.0, 0.0), (0.02, -2.9, 1.05))
    save_calibration(
        path := tmp_path / "c.toml",
        CalibrationFile.model_validate(tree(parameters=found, twist_correction=twist)),
    )
    assert read_calibration(path).parameters.r_m[0] == pytest.approx(most * R[0])


def test_what_no_reader_would_take_is_not_written(tmp_path):
    path = tmp_path / "c.toml"
    with pytest.raises(ConfigError, match=r"c\.toml: not written"):
        save_calibration(path, CalibrationFile.model_validate(tree(parameters=PAPER | {"r_m": (1.0,) * 4})))
    assert not path.exists()


def test_a_robot_of_wheels_on_its_axes_is_taken(tmp_path):
    """A rhombus of wheels: a wheel that stands at x = 0 on paper may be on either side of it."""
    paper = {"x_w_m": (0.2, 0.0, -0.2, 0.0), "y_w_m": (0.0, 0.2, 0.0, -0.2), "r_m": R}
    found = paper | {"x_w_m": (0.21, -0.004, -0.2, 0.004)}
    path = tmp_path / "c.toml"
    save_calibration(path, CalibrationFile.model_validate(tree(parameters=found, nominal=paper)))
    assert read_calibration(path).parameters.x_w_m[1] == -0.004
