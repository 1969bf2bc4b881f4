"""One filter, two ways to compute it: our kernels and filterpy. They agree to 1e-9."""

import numpy as np
import pytest
from estimator_drives import drive

from hil.config.estimator import EstimatorConfig
from hil.estimator import make_estimator
from hil.robot.kinematics import WheelGeometry
from tests.selected import every

SEVERAL = {
    "recommended": {},
    "paper": {"preset": "paper"},
    "dry friction": {"wheels": {"model": "dry-friction"}},
    "creep": {"wheels": {"model": "creep"}},
    "short baseline": {"tracker": {"baseline_s": 0.3}},
    "wheel scale": {"wheel_scale_sigma": 0.01, "tracker": {"scale_sigma": 0.0}},
    "with mocap": {"mocap": {"use": True}},
}


def states(config, cycles, surface="wall"):
    estimator = make_estimator(config, WheelGeometry.nominal(), surface=surface)
    estimator.reset(cycles.start)
    return [estimator.update(m) for m in cycles.measurements]


def assert_same(ours, theirs, tolerance):
    for a, b in zip(ours, theirs, strict=True):
        assert np.allclose(a.pose_body_in_wall, b.pose_body_in_wall, rtol=0, atol=tolerance)
        assert np.allclose(a.twist_body, b.twist_body, rtol=0, atol=tolerance)
        assert np.allclose(a.covariance, b.covariance, rtol=0, atol=tolerance)
        for name, value in a.diagnostics.items():
            if not name.startswith(("nis", "innovation")):
                assert b.diagnostics[name] == pytest.approx(value, rel=1e-6, abs=1e-7), name


@pytest.mark.parametrize(
    ("name", "kind"), every(5, [(name, kind) for name in SEVERAL for kind in ("ekf", "ukf")])
)
def test_compiled_engine_equals_filterpy(kind, name):
    """Turns, late samples, outliers and a lost wheel included: every gate must decide alike."""
    cycles = drive(seconds=1.5, seed=3, outliers=True)
    config = EstimatorConfig(kind=kind, **SEVERAL[name])
    reference = config.model_copy(update={"engine": "filterpy"})
    ours, theirs = states(config, cycles), states(reference, cycles)
    assert_same(ours, theirs, 1e-9)
    if name == "recommended":
        assert ours[-1].diagnostics["rejected_wheels"] > 0
