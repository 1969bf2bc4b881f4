"""Delays come back as they were put in, against the emulated body itself; late devices fail."""

import numpy as np
import pytest
from latency_truth import measured_and_true_ms
from procedure_runs import assert_covered, assert_verifies, run

from hil.procedure.sample_arrays import integrated
from hil.procedures.latency import Parameters
from hil.procedures.latency.fit import Command, fit_delay, fit_driven, fit_response
from tests.patience import FANLESS

AT_100_HZ = FANLESS | {"loop.rate_hz": 100.0}
"""A latency is measured at the rate of the shipped bench."""

SHORT = {"reversals": 10}


def recover(seed):
    """Errors over stated intervals by name; the camera is late by a hidden time, the rest by what it is."""
    late_s = float(np.random.default_rng([seed, 8]).uniform(-0.012, 0.02))
    overrides = {**AT_100_HZ, "emulation.tracker": {"latency_s": 0.02 + late_s}}
    measured, true = measured_and_true_ms(seed, Parameters(reversals=10), overrides)
    assert len(true) == 4 + 5 + 5 + 3
    assert true["tracker.stamp_error"] == pytest.approx(1e3 * late_s, abs=1.1)
    return {name: (measured[name] - true[name]) / measured[f"{name}_uncertainty"] for name in true}, true


def test_every_delay_comes_back():
    ratios, _ = recover(0)
    assert_covered(list(ratios.values()), few=True)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_true_delays_lie_within_the_stated_intervals_over_twenty_seeds():
    runs = [recover(seed) for seed in range(100, 120)]
    for name in runs[0][0]:
        assert_covered([ratios[name] for ratios, _ in runs], few=False)
    phases_ms = [true["imu.stamp_error"] for _, true in runs]
    assert min(phases_ms) < -2.0
    assert max(phases_ms) > 2.0


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    return run("latency", tmp_path_factory.mktemp("latency") / "run", SHORT, seed=1)


def test_a_run_says_what_was_found_and_passes(done):
    assert done.result.verdict.value in ("PASS", "MARGINAL"), done.failed or done.result.error
    assert done.values["servos.velocity_lag"] == pytest.approx(52.0, abs=3.0)
    assert done.values["imu.stamp_error_uncertainty"] < 1.0
    done.assert_held()


@pytest.mark.timeout(600)  # the first process to start may compile the estimators
def test_its_recording_verifies_from_end_to_end(done):
    assert_verifies(done.result.folder / "recording.mcap")


def test_devices_that_are_late_fail(tmp_path):
    faults = ("imu:delayed,delay_s=0.05", "encoders:delayed,delay_s=0.03")
    parameters = {"reversals": 8, "devices": "imu,encoders"}
    done = run("latency", tmp_path / "run", parameters, faults=faults, overrides=AT_100_HZ)
    assert done.result.exit_code == 1
    assert set(done.failed) == {"imu.stamp_error", "imu.age", "encoders.stamp_error"}
    done.assert_held()


def test_a_device_that_does_not_follow_ends_the_run(tmp_path):
    done = run("latency", tmp_path / "run", {"reversals": 8}, faults=("tracker:stuck@3",))
    assert done.result.exit_code == 3
    assert "tracker" in done.result.error.message
    done.assert_held()


@pytest.mark.parametrize("delay", [0.0, 0.0123, 0.2])
def test_a_shifted_way_gives_its_shift(delay):
    t = np.arange(0.0, 12.0, 0.01)
    rate = np.where(np.sin(7.0 * t + np.sin(t)) > 0, 1.0, -1.0)
    command = Command(t, rate)
    seen = np.arange(0.5, 11.5, 0.005)
    found = fit_delay(command, seen, 0.7 * command.path(seen - delay) + 0.3 + 0.01 * seen)
    assert found.delay_s == pytest.approx(delay, abs=1e-5)
    assert found.gain == pytest.approx(0.7, abs=1e-4)
    assert found.misfit < 1e-3


def test_a_lag_counts_as_its_mean_delay():
    """First-order lag of time constant T behind a dead time: the first moment is their sum."""
    t, lag, dead = np.arange(0.0, 30.0, 0.001), 0.03, 0.02
    rate = np.where(np.sin(4.0 * t + np.sin(0.7 * t)) > 0, 1.0, -1.0)
    filtered, state = np.empty_like(t), 0.0
    for k, u in enumerate(np.concatenate([np.zeros(20), rate[:-20]])):
        filtered[k] = state
        state += (1.0 - np.exp(-0.001 / lag)) * (u - state)
    seen, way = t[::10], integrated(t, filtered)[::10]
    found = fit_delay(Command(t, rate), seen, way)
    assert found.delay_s == pytest.approx(lag + dead, abs=2e-5)
    missing = np.sin(11.0 * seen) > -0.3
    assert fit_delay(Command(t, rate), seen[missing], way[missing]).delay_s == pytest.approx(
        found.delay_s, abs=1e-4
    )


def test_a_response_of_any_shape_has_its_mean_delay():
    t = np.arange(0.0, 20.0, 0.01)
    way = np.cumsum(np.where(np.sin(5.0 * t + np.sin(0.9 * t)) > 0, 0.01, -0.01))
    smooth = np.convolve(way, np.full(5, 0.2))[: len(t)]
    box = 0.5 * (np.interp(t - 0.03, t, smooth) + np.interp(t - 0.07, t, smooth))
    found = fit_response(t, smooth, box + 0.1 * t, 0.12)
    assert found.delay_s == pytest.approx(0.05, abs=1e-4)
    assert found.gain == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("delay", [-0.004, 0.0, 0.03])
def test_play_is_not_taken_for_time(delay):
    """Axes with different play, gain and zero behind the servo: only the time is found."""
    fine = np.arange(0.0, 14.0, 0.001)
    phase = 0.08 * np.sin(5.0 * fine + 0.5 * np.sin(fine))
    servo = np.stack([phase, 0.9 * phase, phase, -phase], axis=1)
    axes = np.empty_like(servo)
    for axis, half in enumerate((0.001, 0.002, 0.003, 0.0025)):
        angle = 0.0
        for k, drive in enumerate(servo[:, axis]):
            angle = min(max(angle, drive - half), drive + half)
            axes[k, axis] = (1.0 + 0.01 * axis) * angle + 0.1 * axis
    t, seen = fine[::10], np.arange(0.5, 13.5, 0.005)
    shown = np.stack([np.interp(seen - delay, fine, axes[:, axis]) for axis in range(4)], axis=1)
    found = fit_driven(t, servo[::10], seen, shown, slack_rad=0.017, about_s=delay + 0.002)
    assert found.delay_s == pytest.approx(delay, abs=1e-4)
