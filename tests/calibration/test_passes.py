"""A pass over recordings in both forms, compiled and on arrays: one law, one result, the right slopes."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration import problem as problems
from hil.calibration.blocks import reduce_recordings
from hil.calibration.fitting import fit
from hil.calibration.problem import PAPER, RECOMMENDED, Problem
from hil.calibration.synthetic import hidden_robot, make_set
from hil.robot.kinematics import WheelGeometry
from hil.vocabulary.kernels import AVAILABLE

TYRES = WheelGeometry.nominal().with_tyres([0.5, 1.4, 1.5, 0.6], 0.7)
CASES = [
    (replace(PAPER, bounds=None), 1.0),
    (replace(RECOMMENDED, model="paper"), 1.0),
    (replace(RECOMMENDED, model="exact"), 1.0),
    (replace(RECOMMENDED, model="creep"), 1.0),
    *((RECOMMENDED, power) for power in (2.0, 1.5, 1.2, 1.0)),
]
needs_numba = pytest.mark.skipif(not AVAILABLE, reason="the optional extra `fast` is not installed")


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


@needs_numba
@pytest.mark.parametrize(("setting", "power"), CASES, ids=named)
def test_compiled_and_on_arrays_alike(recordings, setting, power, monkeypatch):
    compiled = a_problem(recordings, setting, power)
    wanted = [compiled.normal_terms(z) for z in neighbours(compiled)]
    plain = a_problem(recordings, setting, power)
    monkeypatch.setattr(problems, "compiled_pass", lambda: None)
    for z, terms in zip(neighbours(plain), wanted, strict=True):
        for found, want in zip(plain.normal_terms(z), terms, strict=True):
            np.testing.assert_allclose(found, want, rtol=1e-10, atol=1e-11 * np.abs(want).max())
    assert plain.evaluations == compiled.evaluations == 2


@pytest.mark.parametrize("compiled", [pytest.param(True, marks=needs_numba), False])
@pytest.mark.parametrize(("setting", "power"), CASES, ids=named)
def test_the_gradient_is_that_of_the_costs(recordings, setting, power, compiled, monkeypatch):
    """Of every recording by itself; dry friction at q = 1 has corners that differences cut across."""
    if not compiled:
        monkeypatch.setattr(problems, "compiled_pass", lambda: None)
    problem = a_problem(recordings, setting, power)
    z = neighbours(problem)[0]
    _, half, _ = problem.normal_terms(z)
    for k in range(len(z)):
        h = 1e-4 * problem.prior_std * np.eye(len(z))[k]
        slope = (problem.recording_costs(z + h) - problem.recording_costs(z - h)) / (2 * h[k])
        apart = np.abs(2 * half[:, k] - slope) / np.abs(slope).max()
        assert np.max(apart) < (0.05 if power == 1.0 and setting.model == "dry-friction" else 1e-3), k


@needs_numba
def test_a_whole_fit_ends_in_one_place(recordings, monkeypatch):
    blocks = reduce_recordings(recordings, 0.3)
    compiled = fit(blocks, RECOMMENDED, TYRES)
    monkeypatch.setattr(problems, "compiled_pass", lambda: None)
    plain = fit(blocks, RECOMMENDED, TYRES)
    assert plain.solution.iterations == compiled.solution.iterations
    apart = np.abs(plain.solution.z - compiled.solution.z) / plain.problem.prior_std
    assert np.max(apart) < 1e-8
    np.testing.assert_allclose(plain.problem.weights, compiled.problem.weights, rtol=1e-8)
