"""Real servo and motion-capture logs with simulated gyro and camera, against the issue's figures."""

import functools

import numpy as np
import pytest
from hybrid import (
    DISTURBANCES,
    HARSH,
    RECOMMENDED_CONFIG,
    SURFACE,
    calibrated,
    data_folder,
    load,
    mean,
    recommended,
    run,
    split,
    streams,
)

from hil.estimator import make_estimator
from tests.selected import every

pytestmark = pytest.mark.skipif(
    not data_folder().is_dir(), reason=f"the public recordings are not at {data_folder()} (set HIL_DATA)"
)


@pytest.fixture(scope="module")
def prepared():
    fitted, held = split(load())
    return {"exact": calibrated(fitted)}, held


def scores(prepared, seeds, config=RECOMMENDED_CONFIG, **changes):
    geometries, held = prepared
    return [
        run(make_estimator(config, geometries["exact"], surface=SURFACE), streams(r, seed, **changes))
        for r in held
        for seed in seeds
    ]


def assert_good(found):
    rmse_mm, heading_deg, _, nees = mean(found)
    assert rmse_mm <= 8.0
    assert heading_deg <= 0.4
    assert 1.5 <= nees <= 4.5


@pytest.mark.long
def test_held_out_repetitions(prepared):
    assert_good(scores(prepared, (0,)))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_held_out_repetitions_of_many_sensors(prepared, kind):
    assert_good(scores(prepared, range(5), RECOMMENDED_CONFIG.model_copy(update={"kind": kind})))


@pytest.mark.long
def test_a_camera_twice_as_bad_as_expected(prepared):
    """One per cent of scale and 5 mm per root metre, which the configuration does not know of."""
    rmse_mm, heading_deg, _, nees = mean(scores(prepared, range(5), camera_errors=HARSH))
    assert rmse_mm <= 8.0
    assert heading_deg <= 0.4
    assert nees <= 6.0


@pytest.fixture(scope="module")
def undisturbed(prepared):
    """End errors of the recommended filter, by recording, each computed once."""
    geometries, held = prepared
    return functools.cache(lambda k: run(recommended(geometries), streams(held[k], 0)).end_m)


def grown_mm(prepared, undisturbed, k, disturb):
    geometries, held = prepared
    after = run(recommended(geometries), disturb(streams(held[k], 0)))
    return 1e3 * (after.end_m - undisturbed(k)), after


@pytest.mark.parametrize("name", every(12, DISTURBANCES))
def test_disturbances_grow_the_end_error_by_3_mm_at_most(prepared, undisturbed, name):
    grown, after = grown_mm(prepared, undisturbed, 2, DISTURBANCES[name])
    assert grown <= 3.0
    assert np.isfinite(after.nees)


@pytest.mark.long
@pytest.mark.parametrize("name", DISTURBANCES)
def test_disturbances_grow_the_end_error_by_3_mm_at_most_in_every_recording(prepared, undisturbed, name):
    for k, recording in enumerate(prepared[1]):
        assert grown_mm(prepared, undisturbed, k, DISTURBANCES[name])[0] <= 3.0, recording.name
