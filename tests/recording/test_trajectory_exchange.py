"""Alignments and relative pose errors as evo defines them, and trajectories in files that others read."""

import json

import numpy as np
import perfect_robot as perfect
import pytest

from hil.cli import main
from hil.core.errors import UsageError
from hil.datasets.capture_files.formats import format_of
from hil.datasets.trajectory_files import write_trajectories
from hil.robot.trajectory_errors import aligned, pairs_by_path, relative_errors

T_S = np.arange(0.0, 20.0, 0.05)
EVO_1_38_1 = {
    "none": (0.04548537713, 0.05110964764, 0.006666537112, 0.007576539026),
    "origin": (0.06206679591, 0.0250560913, 0.006666537112, 0.007576539026),
    "se2": (0.009022868926, 0.04982457041, 0.006666537112, 0.007576539026),
}
"""RMSE of APE (m, rad) and of RPE over 0.1 m of the reference (m, rad), by evo 1.38.1 from `figures`' files.

`APE` and `RPE(delta=0.1, delta_unit=meters, pairs_from_reference=True)` of `evo.core.metrics`, relations
translation_part and rotation_angle_rad, the estimate as it is, after `align_origin`, and after `align`.
"""


def figures():
    """A truth (n, 3) and an estimate that drifts, by closed formulas."""
    turn = 3.0 + 0.4 * np.sin(0.5 * T_S)  # across the wrap of the heading
    truth = np.column_stack([0.8 * np.sin(0.3 * T_S), 0.5 * (1.0 - np.cos(0.4 * T_S)), turn])
    wrong = np.column_stack(
        [0.02 * T_S / 20.0 + 0.03, 0.01 * np.sin(T_S) - 0.02, 0.05 + 0.02 * np.cos(0.9 * T_S)]
    )
    return truth, truth + wrong


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("how", EVO_1_38_1)
def test_figures_are_those_of_evo(how):
    truth, estimate = figures()
    moved = aligned(estimate, truth, how)
    away = moved - truth
    relative = relative_errors(moved, truth, pairs_by_path(truth, 0.1))
    angle = np.arctan2(np.sin(away[:, 2]), np.cos(away[:, 2]))
    found = (rms(np.hypot(away[:, 0], away[:, 1])), rms(angle), *map(rms, relative))
    assert found == pytest.approx(EVO_1_38_1[how], rel=1e-6)


def test_an_alignment_of_another_name_is_refused():
    with pytest.raises(UsageError, match="none or origin or se2"):
        aligned(*figures(), "sim3")


def test_a_path_along_a_line_has_an_alignment():
    """Where evo refuses: the covariance of points on a line has rank one, which is enough in the plane."""
    truth = np.column_stack([np.linspace(0.0, 1.0, 30), np.zeros(30), np.zeros(30)])
    c, s = np.cos(0.3), np.sin(0.3)
    turned = np.column_stack([c * truth[:, 0] + 0.2, s * truth[:, 0] - 0.1, truth[:, 2] + 0.3])
    np.testing.assert_allclose(aligned(turned, truth, "se2"), truth, atol=1e-12)


def test_files_hold_the_poses(tmp_path):
    truth, estimate = figures()
    estimate[7] = np.nan
    files = write_trajectories(tmp_path / "out", T_S, {"truth": truth, "recorded mine": estimate})
    assert sorted(one.name for one in files) == [
        f"{name}.{kind}" for name in ("recorded_mine", "truth") for kind in ("kitti", "tum")
    ]
    data = (tmp_path / "out" / "truth.tum").read_bytes()
    (poses,) = format_of(data).read("truth.tum", data.decode()).values()
    kept = np.delete(np.arange(len(T_S)), 7)
    np.testing.assert_allclose(poses.t_s, T_S[kept], atol=1e-8)
    rows = np.loadtxt(tmp_path / "out" / "recorded_mine.kitti").reshape(-1, 3, 4)
    np.testing.assert_allclose(rows[:, :2, 3], estimate[kept, :2], atol=1e-8)
    np.testing.assert_allclose(np.exp(1j * estimate[kept, 2]), rows[:, 0, 0] + 1j * rows[:, 1, 0], atol=1e-8)
    np.testing.assert_allclose(np.linalg.det(rows[:, :, :3]), 1.0, atol=1e-7)


def test_replay_aligns_and_writes(tmp_path, capsys):
    made, _, _ = perfect.bag_as_read(tmp_path)
    line = [
        "replay",
        str(made),
        "--topics",
        str(tmp_path / "topics.toml"),
        "--estimator",
        "odometry",
        "--json",
    ]
    found = {}
    for how in ("none", "origin", "se2"):
        assert main([*line, "--align", how, "--trajectories", str(tmp_path / how)]) == 0
        found[how] = json.loads(capsys.readouterr().out)["estimators"]["odometry"]
    assert found["se2"]["rmse_position_m"] <= found["none"]["rmse_position_m"]
    assert len({round(one["rpe_position_m"], 9) for one in found.values()}) == 1
    truth, own = (np.loadtxt(tmp_path / "none" / f"{name}.tum") for name in ("truth", "odometry"))
    written = rms(np.hypot(*(own[:, 1:3] - truth[:, 1:3]).T))
    assert written == pytest.approx(found["none"]["rmse_position_m"], rel=1e-5)
