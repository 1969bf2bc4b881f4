"""A pass over recordings: what numpy finds on arrays, and the right slopes."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.problem import PAPER, RECOMMENDED, Problem
from hil.calibration.synthetic import hidden_robot, make_set
from hil.datasets.fit_blocks import reduce_recordings
from hil.robot.kinematics import WheelGeometry

TYRES = WheelGeometry.nominal().with_tyres([0.5, 1.4, 1.5, 0.6], 0.7)
CASES = [
    (replace(PAPER, bounds=None), 1.0),
    (replace(RECOMMENDED, model="paper"), 1.0),
    (replace(RECOMMENDED, model="exact"), 1.0),
    (replace(RECOMMENDED, model="creep"), 1.0),
    *((RECOMMENDED, power) for power in (2.0, 1.5, 1.2, 1.0)),
]


@pytest.fixture(scope="module")
def recordings():
    return make_set(hidden_robot(5), 5, repetitions=2)


def a_problem(recordings, setting, power):
    blocks = reduce_recordings(recordings, 0.3, setting.signal)
    return Problem(blocks, setting, TYRES).with_power(power)


def neighbours(problem):
    """Parameters far from the last ones, the same again, near the last ones: every way to begin a pass."""
    step = problem.prior_std * np.random.default_rng(1).standard_normal(len(problem.nominal))
    far = problem.nominal + step
    return far, far, far + 1e-3 * step / np.abs(step).max()


def named(case):
    return f"{case.model}-{case.signal}" if hasattr(case, "model") else f"{case:g}"


@pytest.mark.parametrize(("setting", "power"), CASES, ids=named)
def test_a_pass_finds_what_numpy_finds_on_arrays(recordings, setting, power):
    """Of errors as they are weighed, their derivatives, and sums of products of these."""
    passed, arrays = a_problem(recordings, setting, power), a_problem(recordings, setting, power)
    scale = arrays.blocks.mask[..., None] * arrays._scale[:, None]
    for z in neighbours(passed):
        errors, slopes = arrays.errors_and_jacobian(z)
        e = (errors * scale).reshape(len(errors), -1)
        j = (slopes * scale[..., None]).reshape(len(errors), -1, len(z))
        wanted = (e**2).sum(axis=1), np.einsum("rka,rk->ra", j, e), np.einsum("rka,rkb->rab", j, j)
        for found, want in zip(passed.normal_terms(z), wanted, strict=True):
            np.testing.assert_allclose(found, want, rtol=1e-10, atol=1e-11 * np.abs(want).max())
    assert passed.evaluations == 2


@pytest.mark.parametrize(("setting", "power"), CASES, ids=named)
def test_the_gradient_is_that_of_the_costs(recordings, setting, power):
    """Of every recording by itself; dry friction at q = 1 has corners that differences cut across."""
    problem = a_problem(recordings, setting, power)
    z = neighbours(problem)[0]
    _, half, _ = problem.normal_terms(z)
    for k in range(len(z)):
        h = 1e-4 * problem.prior_std * np.eye(len(z))[k]
        slope = (problem.recording_costs(z + h) - problem.recording_costs(z - h)) / (2 * h[k])
        apart = np.abs(2 * half[:, k] - slope) / np.abs(slope).max()
        assert np.max(apart) < (0.05 if power == 1.0 and setting.model == "dry-friction" else 1e-3), k
