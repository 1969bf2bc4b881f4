"""A camera mounted and delayed otherwise than believed is found where it is."""

import math

import numpy as np
import pytest
from procedure_runs import (
    assert_covered,
    assert_covered_over_twenty_seeds,
    fragment_of,
    part,
    run,
    true_world,
)

from hil.config.loading import load_bench
from hil.core.geometry import quat_from_rotvec, quat_multiply, quat_rotate
from hil.fakes.tracker.t265.chip import T265
from hil.procedure.sample_arrays import Series
from hil.procedures.tracker_extrinsics import headline
from hil.procedures.tracker_extrinsics.hand_eye import Truth, intervals, solve

SHORT = {"repetitions": 1, "way_m": 0.15, "turn_deg": 60.0}
QUICK = {"repetitions": 1, "way_m": 0.1, "turn_deg": 40.0}
BELIEVED_M, LATENCY_S = (0.1489, 0.0092, 0.0666), 0.020


def hidden(seed):
    """Where the camera truly is: x, y (mm), turns (deg) and lateness (ms), and as emulation options."""
    rng = np.random.default_rng([seed, 3])
    shift, turn, late = rng.uniform(-0.02, 0.02, 2), rng.uniform(-0.05, 0.05, 3), rng.uniform(-0.01, 0.02)
    position = [BELIEVED_M[0] + shift[0], BELIEVED_M[1] + shift[1], BELIEVED_M[2]]
    options = {
        "mount_position_m": [float(v) for v in position],
        "mount_rotation_wxyz": [float(v) for v in quat_from_rotvec(turn)],
        "latency_s": LATENCY_S + float(late),
    }
    return np.array([*np.multiply(position[:2], 1e3), *np.degrees(turn), 1e3 * late]), options


def scale_of(seed, bench, options):
    return part(true_world(bench, seed, {"emulation.tracker": options}), T265).odometry.scale


def as_bench(folder):
    """The fragment in a bench file, as a lab would use it."""
    fragment = (folder / "bench_fragment.toml").read_text()
    (folder / "bench.toml").write_text('schema = 1\nname = "lab"\n' + fragment)
    return load_bench(folder / "bench.toml").tracker


def recover(seed, folder, parameters=SHORT, scale=1.0, **source):
    truth, options = hidden(seed)
    options["scale"] = scale
    overrides = {"emulation.tracker": options}
    done = run("tracker_extrinsics", folder, parameters, seed=seed, overrides=overrides, **source)
    assert done.result.verdict.value in ("PASS", "MARGINAL"), done.failed or done.result.error
    done.assert_held()
    values = done.values
    found = np.array(
        [values[n] for n in ("mount_x", "mount_y")]
        + [values[f"{n}_correction"] for n in ("roll", "pitch", "yaw")]
        + [values["late"], values["scale"]]
    )
    half = np.array(
        [values[f"{n}_uncertainty"] for n in ("mount_x", "mount_y", "roll", "pitch", "yaw", "late", "scale")]
    )
    true_scale = scale_of(seed, source.get("bench", "emulated_floor"), options)
    fragment = fragment_of(folder)["tracker"]
    assert fragment["scale"] == pytest.approx(values["scale"], abs=1e-5)
    between_sessions = 0.001
    sigma = np.hypot(values["scale_uncertainty"] / 2.0, between_sessions)
    assert fragment["scale_sigma"] == pytest.approx(sigma, rel=0.05)
    assert fragment["scale"] == pytest.approx(true_scale, abs=4.0 * fragment["scale_sigma"])
    read = as_bench(folder)
    assert (read.scale, read.scale_sigma) == (fragment["scale"], fragment["scale_sigma"])
    assert fragment["latency_s"] == pytest.approx(options["latency_s"], abs=0.006)
    assert fragment["mount_position_m"][:2] == pytest.approx(options["mount_position_m"][:2], abs=0.004)
    return ((found - [*truth, true_scale]) / half).tolist(), done


def test_a_camera_is_found_where_it_is_how_late_it_is_and_how_far_its_scale_is_off(tmp_path):
    ratios, done = recover(1, tmp_path / "run", QUICK, scale=0.77)
    assert_covered(ratios, few=True)
    assert done.values["scale"] == pytest.approx(0.77, abs=0.03)
    assert done.values["applied.position_rmse"] < 0.5 * done.values["before.position_rmse"]


@pytest.mark.long
@pytest.mark.parametrize("scale", [0.77, 1.0, 1.28])
def test_a_scale_that_is_far_off_is_found(tmp_path, scale):
    ratios, done = recover(4, tmp_path / "run", QUICK, scale=scale)
    assert done.values["scale"] == pytest.approx(scale, abs=0.03)
    assert_covered(ratios, few=True)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_true_mounts_lie_within_the_stated_intervals_over_twenty_seeds(tmp_path):
    assert_covered_over_twenty_seeds(recover, tmp_path)


@pytest.mark.long
def test_a_camera_is_found_on_the_wall_too(tmp_path):
    assert_covered(recover(3, tmp_path / "run", bench="emulated")[0], few=True)


def test_a_camera_that_measures_wrongly_and_late_fails(tmp_path):
    faults = ("tracker:wrong,scale=1.5", "tracker:delayed,delay_s=0.08")
    done = run("tracker_extrinsics", tmp_path / "run", QUICK | {"turn_deg": 30.0}, faults=faults)
    assert done.result.exit_code == 1
    assert {"scale", "late"} <= set(done.failed)
    assert not (tmp_path / "run" / "bench_fragment.toml").exists()
    done.assert_held()


def test_a_camera_that_falls_silent_ends_the_run(tmp_path):
    done = run("tracker_extrinsics", tmp_path / "run", SHORT, faults=("tracker:off@3",))
    assert done.result.exit_code == 3
    assert "tracker" in done.result.error.message
    done.assert_held()


def series(t, values):
    return Series(t, t, np.full(len(t), np.nan), values, len(t))


def test_hand_eye_recovers_an_exact_camera_exactly():
    """By construction: poses of the body, and of the camera on it, as formulas of time."""
    t = np.arange(0.0, 20.0, 0.01)
    body = np.column_stack([0.3 * np.sin(0.5 * t), 0.2 * np.sin(0.8 * t), 1.2 * np.sin(0.6 * t)])
    mount_m, mount = np.array([0.15, -0.02, 0.05]), quat_from_rotvec([0.02, -0.03, 0.1])
    scale, late = 1.01, 0.015
    frame = quat_from_rotvec([0.3, -1.2, 0.4])
    seen_t = np.arange(0.1, 19.9, 0.005)
    at = np.column_stack([np.interp(seen_t - late, t, body[:, k]) for k in range(3)])
    rows = []
    for x, y, theta in at:
        turn = quat_from_rotvec([0.0, 0.0, theta])
        c, s = math.cos(theta), math.sin(theta)
        place = np.array([x + c * mount_m[0] - s * mount_m[1], y + s * mount_m[0] + c * mount_m[1], 0.05])
        attitude = quat_multiply(frame, quat_multiply(turn, mount))
        rows.append(np.concatenate([scale * quat_rotate(frame, place), attitude, np.zeros(6)]))
    found = solve(
        intervals(series(seen_t, np.array(rows))), Truth(series(t, body)), (0.14, 0.0, 0.05), (1.0, 0, 0, 0)
    )
    assert found.position_m == pytest.approx(mount_m[:2], abs=1e-5)
    assert found.angles_rad == pytest.approx([0.02, -0.03, 0.1], abs=1e-5)
    assert (found.scale, found.late_s) == pytest.approx((scale, late), abs=1e-5)


@pytest.mark.parametrize(("before_mm", "after_mm"), [(1.8, 1.9), (9.0, 1.9)])
def test_the_headline_claims_no_improvement_that_is_none(before_mm, after_mm):
    values = {"mount_x": 10.0, "mount_y": 0.0, "before.position_rmse": before_mm}
    said = headline({**values, "applied.position_rmse": after_mm})
    assert "fell" not in said
    assert said.index(f"{after_mm} mm") < said.index("before") < said.index(f"{before_mm} mm")


def test_a_camera_too_noisy_to_show_its_delay_keeps_it_and_its_scale_is_found(tmp_path):
    noisy = {"position_noise_m": 0.0009, "angle_noise_rad": 0.0015, "scale": 1.25}
    done = run("tracker_extrinsics", tmp_path, SHORT, seed=0, overrides={"emulation.tracker": noisy})
    assert done.result.verdict.value == "MARGINAL", done.failed or done.result.error
    assert 4.0 < done.values["late_uncertainty"] < 12.0
    fragment = fragment_of(tmp_path)["tracker"]
    assert fragment["latency_s"] == LATENCY_S
    assert fragment["scale"] == pytest.approx(1.25, abs=0.01)
