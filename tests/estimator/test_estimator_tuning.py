"""Tuning: finds noise that was put in, keeps what is good, refuses what it cannot fit."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from estimator_drives import drive

from hil.cli.tune import command
from hil.config.estimator import EstimatorConfig
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, UsageError
from hil.estimator.tuning import TruthRun, score, tunable, tune, with_values
from hil.robot.kinematics import WheelGeometry

NAMES = ("wheels.step_m", "wheels.per_sqrt_m")


def truth_run(seed, seconds=4.0):
    """No camera: the pose error is what wheels and inertial unit make of it."""
    d = drive(seconds=seconds, seed=seed, wheel_noise_m=3e-4)
    parts = tuple(type(m)(m.cycle, m.t_ns, m.wheels, m.gyro) for m in d.measurements)
    truth = d.path.at(np.array([m.t_ns for m in parts]) * 1e-9)
    return TruthRun(parts, d.start, truth, WheelGeometry.nominal(), "wall")


@pytest.fixture(scope="module")
def no_slip():
    still = {
        "slip_m_s": 0.0,
        "slip_across_m_s": 0.0,
        "creep": 0.0,
        "creep_across": 0.0,
        "yaw_rad_m": 0.0,
        "yaw_per_sqrt_m": 0.0,
    }
    return EstimatorConfig(wall=still, wheels={"step_m": 2e-3, "per_sqrt_m": 2e-2})


def test_noise_that_is_far_too_large_is_found(no_slip):
    runs, held = [truth_run(s) for s in range(2)], [truth_run(s) for s in (7, 8)]
    found = tune(no_slip, runs, NAMES, evaluations=24)
    assert found.evaluations <= 24
    assert found.after.likelihood < found.before.likelihood - 1.0
    assert score(found.config, held).likelihood < score(no_slip, held).likelihood - 1.0
    assert found.values["wheels.step_m"] < 1.2e-3
    assert found.after.nees < 4.5
    few = tune(no_slip, runs[:1], NAMES, evaluations=5)
    assert tune(no_slip, runs[:1], NAMES, evaluations=5).values == few.values


def seen_by_camera(seed):
    d = drive(seconds=4.0, seed=seed, wheel_noise_m=3e-4)
    truth = d.path.at(np.array([m.t_ns for m in d.measurements]) * 1e-9)
    return TruthRun(d.measurements, d.start, truth, WheelGeometry.nominal(), "wall")


@pytest.mark.parametrize(
    ("name", "begin", "low", "high"),
    [
        ("tracker.position_m", 2e-2, 0.7e-3, 1.3e-3),
        ("process.angular_acceleration_rad_s2_sqrt_hz", 3.0, 0.0, 0.1),
    ],
)
def test_noise_of_samples_and_of_the_process_are_found(name, begin, low, high):
    """The camera's true noise is 1 mm. By the pose alone the first search went to 0.06 mm."""
    config = EstimatorConfig(wheels={"step_m": 3e-4, "per_sqrt_m": 1e-4})
    found = tune(with_values(config, {name: begin}), [seen_by_camera(0)], [name], evaluations=14)
    assert low < found.values[name] < high
    assert found.after.innovations < found.before.innovations


def test_every_tunable_figure_can_be_replaced():
    config = EstimatorConfig()
    for name, value in tunable(config, "wall").items():
        table, key = name.split(".")
        assert getattr(getattr(with_values(config, {name: 1.5 * value}), table), key) == 1.5 * value
    with pytest.raises(UsageError, match="cannot tune"):
        tune(config, [truth_run(0, 1.0)], ["gates.on"])
    blind = truth_run(0, 1.0)
    blind = TruthRun(
        blind.measurements, blind.start, np.full_like(blind.truth, np.nan), blind.geometry, "wall"
    )
    with pytest.raises(UsageError, match="no ground truth"):
        tune(config, [blind], NAMES)


def test_the_command_saves_what_it_found(tmp_path, capsys, csv_with_truth):
    out = tmp_path / "tuned.toml"
    arguments = [str(csv_with_truth), "--evaluations", "3", "--out", str(out), "--json"]
    assert command.main([*arguments, "--parameter", "wheels.per_sqrt_m"], standalone_mode=False) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["evaluations"] == 3
    assert f"per_sqrt_m = {result['values']['wheels.per_sqrt_m']:.4g}" in out.read_text()
    bench = tmp_path / "bench.toml"
    bench.write_text(
        'schema = 1\nname = "table"\n[environment]\nsurface = "floor"\ntilt_rad = 0.0\n'
        "[robot]\nwheel_radius_m = [0.03, 0.03, 0.03, 0.03]\n[estimator.gates]\none_dof = 9.0\n"
    )
    assert command.main([*arguments, "--bench", str(bench)], standalone_mode=False) == 0
    assert json.loads(capsys.readouterr().out)["geometry"]["r_m"] == [0.03] * 4
    assert result["geometry"]["r_m"] == [0.0254] * 4
    saved = out.read_text()
    assert 'name = "table"' in saved
    assert "one_dof = 9.0" in saved
    assert "per_sqrt_m" in saved
    assert "[estimator.tracker]" not in saved


def test_what_the_recordings_say_nothing_about_is_not_fitted(tmp_path, capsys, csv_with_truth):
    """Noise of gyro and camera, which are not there, had been written as if fitted."""
    out = tmp_path / "tuned.toml"
    words = [str(csv_with_truth), "--evaluations", "30", "--out", str(out)]
    assert command.main([*words, "--json"], standalone_mode=False) == 0
    result = json.loads(capsys.readouterr().out)
    silent = ["tracker.drift_per_sqrt_m", "tracker.position_m", "gyro.rate_rad_s"]
    assert result["silent"] == silent
    assert not set(silent) & set(result["values"])
    assert result["untried"] == []
    assert "tracker" not in out.read_text()
    assert "gyro" not in out.read_text()
    for name in ("gyro.rate_rad_s", "wheels.steering_m_rad"):  # it has no gyro, its wheels do not steer
        with pytest.raises(UsageError, match=f"say nothing about {name}"):
            command.main([*words, "--parameter", name], standalone_mode=False)


def test_the_gravity_heading_is_not_fitted_where_it_is_not_used():
    config, runs = EstimatorConfig(gyro={"use_gravity": False}), [truth_run(0, 2.0)]
    found = tune(config, runs, ("wheels.step_m", "gyro.gravity_rad"), evaluations=9)
    assert found.silent == ("gyro.gravity_rad",)
    assert list(found.values) == ["wheels.step_m"]


def test_what_the_budget_does_not_reach_is_not_fitted():
    found = tune(EstimatorConfig(), [truth_run(0, 2.0)], NAMES, evaluations=2)
    assert list(found.values) == [NAMES[0]]
    assert found.untried == (NAMES[1],)


def test_a_folder_of_our_recordings_is_read_with_all_their_sensors(tmp_path, capsys, monkeypatch):
    """They had been read as tables, which hold wheels and truth alone."""
    opened = []
    monkeypatch.setattr(
        "hil.replay.recordings.open_recording", lambda path, **options: opened.append(path) or 1 / 0
    )
    (tmp_path / "run.mcap").touch()
    with pytest.raises(ZeroDivisionError):
        command.main([str(tmp_path)], standalone_mode=False)
    assert opened == [tmp_path / "run.mcap"]


def test_a_recording_of_another_robot_than_the_benchs_is_refused(monkeypatch, tmp_path):
    """The recording says which wheels it was made with; a bench file with others cannot be its robot's."""
    config = load_bench("emulated_floor")
    recorded = {**config.robot.model_dump(), "wheel_radius_m": [0.04] * 4}
    opened = SimpleNamespace(header={"config": {"robot": recorded}}, bench=SimpleNamespace(config=config))
    monkeypatch.setattr("hil.replay.recordings.open_recording", lambda path, **options: opened)
    path = tmp_path / "run.mcap"
    path.touch()
    with pytest.raises(ConfigError, match=r"robot.wheel_radius_m: \[0.04, .* there, \[0.0254") as error:
        command.main([str(path), "--bench", "emulated_floor"], standalone_mode=False)
    assert "another robot" in str(error.value)


def write_drive(path, noise_rad):
    """Plain CSV: wheels with noise and ground truth of a short straight drive."""
    rng = np.random.default_rng(1)
    lines = ["t,phi1,phi2,phi3,phi4,delta1,delta2,delta3,delta4,x,y,theta"]
    for k in range(400):
        x = 0.05 * max(0.0, k * 0.01 - 1.0)
        angles = x / 0.0254 + noise_rad * rng.normal(size=4)
        row = [k * 0.01, *angles, 0, 0, 0, 0, x, 0.0, 0.0]
        lines.append(",".join(f"{v:.6f}" for v in row))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def csv_with_truth(tmp_path):
    return write_drive(tmp_path / "line_x_1.csv", 2e-3)


@pytest.mark.parametrize(("noise_rad", "verdict"), [(2e-3, "PASS"), (0.02, "FAIL")])
def test_figures_that_do_worse_on_what_was_held_out_fail_and_say_so(
    tmp_path, capsys, csv_with_truth, noise_rad, verdict
):
    other, out = write_drive(tmp_path / "held_1.csv", noise_rad), tmp_path / "tuned.toml"
    words = [str(csv_with_truth), "--check", str(other), "--evaluations", "6", "--parameter", "wheels.step_m"]
    code = command.main([*words, "--out", str(out), "--json"], standalone_mode=False)
    said = capsys.readouterr()
    found = json.loads(said.out)
    before, after = (found["held_out"][k]["likelihood"] for k in ("before", "after"))
    assert found["fitted"]["after"]["likelihood"] < found["fitted"]["before"]["likelihood"]
    assert (code, found["verdict"], after > before) == {
        "PASS": (0, "PASS", False),
        "FAIL": (1, "FAIL", True),
    }[verdict]
    assert out.exists()
    warned = [line for line in said.err.splitlines() if line.startswith("warning: ")]
    assert len(warned) == len(found["warnings"]) == (verdict == "FAIL")
    assert all(f"-ln L {before:.2f} -> {after:.2f}" in line for line in warned)


def test_what_is_given_twice_is_fitted_once_and_never_held_out_too(tmp_path, capsys, csv_with_truth):
    folder = csv_with_truth.parent
    words = ["--evaluations", "2", "--parameter", "wheels.per_sqrt_m", "--json"]
    assert command.main([str(csv_with_truth), *words], standalone_mode=False) == 0
    once = capsys.readouterr()
    assert json.loads(once.out)["verdict"] is None
    assert command.main([str(csv_with_truth), str(folder), *words], standalone_mode=False) == 0
    twice = capsys.readouterr()
    assert twice.out == once.out
    assert twice.err.count("given more than once, taken once") == 1
    with pytest.raises(UsageError, match="fitted and held out at once"):
        command.main([str(folder), "--check", str(csv_with_truth), *words], standalone_mode=False)


@pytest.mark.parametrize(
    ("text", "why"),
    [('schema = 1\nname = "lab"\n', "holds no"), ('schema = 1\nname = "lab"\n[estimator]\n', "is the bench")],
)
def test_fitted_figures_are_not_written_over_what_is_none(tmp_path, text, why):
    out = tmp_path / "bench.toml"
    out.write_text(text)
    bench = ("--bench", str(out)) if "is the" in why else ()
    refused = CliRunner().invoke(command, [str(tmp_path), "--out", str(out), *bench], standalone_mode=False)
    assert isinstance(refused.exception, UsageError)
    assert f"--out {out}: " in str(refused.exception)
    assert why in str(refused.exception)
    assert out.read_text() == text
