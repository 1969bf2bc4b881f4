"""Delays come back as they were put in, against the emulated body itself; late devices fail."""

import numpy as np
import pytest
from procedure_runs import assert_covered, run

from hil.bench import open_bench
from hil.clock import NS_PER_S
from hil.fakes.plant.robot import STEP_NS
from procedures.latency import Parameters, body_signals, turn
from procedures.parts.latency_fit import Command, fit_delay, integrated

SHORT = {"reversals": 10}
GRID_MS = 1e-6 * STEP_NS


def hidden_late_s(seed):
    return float(np.random.default_rng([seed, 8]).uniform(-0.012, 0.02))


def true_delay_s(seed, overrides):
    """Command to motion of the body itself, which no device has looked at."""
    poses, times = [], []

    class Probe:
        def write(self, record):
            poses.append(bench.truth().pose_body_in_wall[2])
            times.append(bench.world.plant.t_ns)

        def close(self):
            pass

    p = Parameters(**SHORT)
    with open_bench("emulated", seed=seed, overrides=overrides) as bench:
        bench.add_sink(Probe())
        motion = turn(bench, p)
        command, _ = body_signals(bench, motion, p)
    origin_ns = motion.records[0].inputs.t_ns
    t_s = (np.array(times, dtype=np.int64) - origin_ns) / NS_PER_S
    return fit_delay(command, t_s[t_s >= 0], np.array(poses)[t_s >= 0]).delay_s


def beyond_grid(error_ms, low, high):
    """The emulated body moves in steps of 1 ms, so that a device sees it up to one step old."""
    return error_ms - min(max(error_ms, low * GRID_MS), high * GRID_MS)


def recover(seed, folder):
    late_s = hidden_late_s(seed)
    overrides = {"emulation.tracker": {"latency_s": 0.02 + late_s}}
    done = run("latency", folder, SHORT, seed=seed, overrides=overrides)
    values = done.values
    assert set(done.failed) <= {"tracker.stamp_error"}, done.failed
    done.assert_held()
    body_ms = values["body.command_to_motion"] - 1e3 * true_delay_s(seed, overrides)
    stamp_ms = values["tracker.stamp_error"] - 1e3 * late_s
    return [
        beyond_grid(body_ms, 0, 1) / values["body.command_to_motion_uncertainty"],
        beyond_grid(stamp_ms, -1, 1) / values["tracker.stamp_error_uncertainty"],
    ], done


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_delays_come_back(tmp_path, seed):
    ratios, done = recover(seed, tmp_path / "run")
    assert_covered(ratios, few=True)
    assert done.values["servos.velocity_lag"] == pytest.approx(52.0, abs=3.0)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_true_delays_lie_within_the_stated_intervals_over_twenty_seeds(tmp_path):
    ratios = [r for seed in range(100, 120) for r in recover(seed, tmp_path / str(seed))[0]]
    assert_covered(ratios, few=False)


def test_devices_that_are_late_fail(tmp_path):
    faults = ("imu:delayed,delay_s=0.05", "encoders:delayed,delay_s=0.03")
    done = run("latency", tmp_path / "run", {"reversals": 8}, faults=faults)
    assert done.result.exit_code == 1
    assert set(done.failed) == {"imu.stamp_error", "encoders.stamp_error"}
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
    found = fit_delay(command, seen, 0.7 * command.way(seen - delay) + 0.3 + 0.01 * seen)
    assert found.delay_s == pytest.approx(delay, abs=1e-5)
    assert found.gain == pytest.approx(0.7, abs=1e-4)
    assert found.misfit < 1e-3


def test_a_lag_counts_as_its_mean_delay():
    """First-order lag of time constant T behind a dead time: the first moment is nearly their sum."""
    t, lag, dead = np.arange(0.0, 30.0, 0.001), 0.03, 0.02
    rate = np.where(np.sin(4.0 * t + np.sin(0.7 * t)) > 0, 1.0, -1.0)
    filtered, state = np.empty_like(t), 0.0
    for k, u in enumerate(np.interp(t - dead, t, rate)):
        state += 0.001 / lag * (u - state)
        filtered[k] = state
    found = fit_delay(Command(t, rate), t[::10], integrated(t, filtered)[::10])
    assert found.delay_s == pytest.approx(lag + dead, abs=0.1 * lag)
