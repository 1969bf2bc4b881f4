"""A calibration brings its wheel model along, unless the bench file names one; a difference is said."""

import logging

import pytest
import tomli_w

import hil
from hil.bench.doctor.examination import examine
from hil.calibration.calibration_file import save_calibration
from hil.config.loading import load_bench
from hil.core.errors import ConfigError
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from tests.procedures.made_calibrations import made

MODEL = "estimator.wheels.model"
TYRES = {"load": [0.5, 1.4, 1.5, 0.6], "creep_ratio": 0.8}


@pytest.fixture
def calibration(tmp_path):
    def write(model, name="calibration.toml", loaded=False):
        tyres = {"tyres": TYRES} if model == "creep" or loaded else {}
        save_calibration(tmp_path / name, made(version=4, model=model, made_for=None, **tyres))
        return tmp_path / name

    return write


@pytest.mark.parametrize(
    ("fitted", "expected"),
    [("exact", "equations"), ("paper", "paper"), ("dry-friction", "dry-friction"), ("creep", "creep")],
)
def test_the_estimators_read_the_wheels_as_the_calibration_was_fitted(calibration, fitted, expected):
    bench = hil.open_bench("emulated_floor", calibration=calibration(fitted))
    with bench:
        assert bench.config.estimator.wheels.model == expected
        assert bench.header()["config"]["estimator"]["wheels"]["model"] == expected
        assert bench.model.make_estimator("ekf").config.wheels.model == expected


def test_the_calibration_of_the_bench_file_counts_too(calibration, tmp_path):
    overrides = {"calibration": str(calibration("dry-friction"))}
    with hil.open_bench("emulated_floor", overrides=overrides) as bench:
        assert bench.config.estimator.wheels.model == "dry-friction"
    with hil.open_bench(load_bench("emulated_floor", overrides=overrides)) as bench:
        assert bench.config.estimator.wheels.model == "dry-friction"


def test_a_model_that_the_bench_file_names_stays_and_is_said(calibration, caplog):
    caplog.set_level(logging.WARNING)
    path = calibration("dry-friction")
    bench = hil.open_bench("emulated_floor", overrides={MODEL: "equations"}, calibration=path)
    assert bench.config.estimator.wheels.model == "equations"
    assert "fitted with the dry-friction model" in caplog.text
    first = next(examine(bench, watch_s=0.1))
    assert (first.device, first.level) == ("bench", "warning")
    assert "version 4" in first.found
    assert "dry-friction" in first.remedy


def test_doctor_says_that_calibration_and_model_agree(calibration, caplog):
    caplog.set_level(logging.WARNING)
    first = next(examine(hil.open_bench("emulated_floor", calibration=calibration("exact")), watch_s=0.1))
    assert (first.device, first.level) == ("bench", "ok")
    assert caplog.text == ""


def test_replay_with_another_calibration_takes_its_model(calibration, tmp_path):
    path = tmp_path / "rest.mcap"
    bench = hil.open_bench("emulated_floor")
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        bench.observe(0.1, feedback="odometry")
    assert open_recording(path).bench.config.estimator.wheels.model == "equations"
    again = open_recording(path, calibration=calibration("dry-friction")).bench
    assert again.config.estimator.wheels.model == "dry-friction"
    file = tmp_path / "bench.toml"
    tree = load_bench("emulated_floor", overrides={MODEL: "paper"}).model_dump(
        mode="json", by_alias=True, exclude_unset=True
    )
    file.write_text(tomli_w.dumps(tree))
    chosen = open_recording(path, bench=str(file), calibration=calibration("dry-friction")).bench
    assert chosen.config.estimator.wheels.model == "paper"


@pytest.mark.parametrize("model", ["creep", "dry-friction"])
def test_loads_and_tyres_of_a_calibration_reach_the_estimator_and_the_recording(calibration, tmp_path, model):
    path = tmp_path / "rest.mcap"
    bench = hil.open_bench("emulated_floor", calibration=calibration(model, loaded=True))
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        bench.observe(0.1, feedback="odometry")
    again = open_recording(path).bench
    for geometry in (bench.geometry, again.geometry):
        assert geometry.load.tolist() == TYRES["load"]
        assert geometry.creep_ratio == TYRES["creep_ratio"]


def test_without_a_calibration_loads_follow_from_the_robot_as_configured():
    """A centre of mass 49 mm behind the middle loads the rear wheels; the sum is the weight."""
    with hil.open_bench("emulated_floor") as bench:
        load, robot = bench.geometry.load, bench.config.robot
        assert load.sum() == pytest.approx(4.0)
        assert load @ bench.geometry.x_m / 4 == pytest.approx(robot.centre_of_mass_m[0])
        assert load @ bench.geometry.y_m / 4 == pytest.approx(robot.centre_of_mass_m[1])
        assert bench.geometry.creep_ratio == robot.creep_ratio == pytest.approx(0.7)


def test_a_creep_calibration_without_its_tyres_is_refused(calibration, tmp_path):
    path = calibration("creep")
    text = path.read_text()
    path.write_text(text[: text.index("[tyres]")])
    with pytest.raises(ConfigError) as error:
        hil.open_bench("emulated_floor", calibration=path)
    assert any("tyres" in problem for problem in error.value.problems)
