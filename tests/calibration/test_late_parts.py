"""Wheels, or positions against the heading, that come late in a whole set are named, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.datasets.late_parts import with_late_parts
from hil.datasets.plain_csv import write_plain
from hil.datasets.read import read_recordings

pytestmark = pytest.mark.long


@pytest.fixture(scope="module", params=["viscous", "elastic"])
def healthy(request):
    return make_set(hidden_robot(4, contact=request.param), 4, MOTIONS, 2, slip_share=0.5)


def wheels_late(one, wheels, by_s):
    angle, steering = one.wheel_angle_rad.copy(), one.steering_rad.copy()
    for columns in (angle, steering):
        for i in wheels:
            columns[:, i] = np.interp(one.t_s - by_s, one.t_s, columns[:, i])
    return replace(one, wheel_angle_rad=angle, steering_rad=steering)


def truth_late(one, columns, by_s):
    pose = one.truth_pose.copy()
    for j in columns:
        pose[:, j] = np.interp(one.truth_t_s - by_s, one.truth_t_s, pose[:, j])
    return replace(one, truth_pose=pose)


def said_of(recordings):
    return [one.contradictions[0] for one in with_late_parts(recordings) if one.contradictions]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda one: wheels_late(one, [0], 0.05), ("FL wheel (phi1", "later than the other three")),
        (lambda one: wheels_late(one, [2], -0.08), ("BR wheel (phi3", "0.08 s earlier")),
        (lambda one: wheels_late(one, [0, 1], 0.08), ("FL and BL wheels come 0.08 s later", "either pair")),
        (lambda one: wheels_late(one, [2, 3], -0.15), ("FL and BL wheels come 0.1", "later")),
        (lambda one: wheels_late(one, [0, 2], 0.08), ("FL and BR wheels come 0.08 s later", "either pair")),
        (lambda one: truth_late(one, [0, 1], 0.1), ("positions", "later than its heading")),
        (lambda one: truth_late(one, [0, 1], 0.3), ("positions", "later than its heading")),
        (lambda one: truth_late(one, [2], 0.06), ("positions", "earlier than its heading")),
        (lambda one: truth_late(one, [2], 0.2), ("positions", "earlier than its heading")),
    ],
)
def test_what_is_late_is_named_in_every_recording(healthy, spoil, words):
    said = said_of([spoil(one) for one in healthy])
    assert len(said) == len(healthy)
    assert all(word in said[0] for word in words)


@pytest.mark.parametrize("by_s", [-0.4, 0.0, 0.1])
def test_ground_truth_that_is_late_as_a_whole_is_left_to_its_correction(healthy, by_s):
    delays = by_s + np.random.default_rng(1).normal(0.0, 0.02, len(healthy))
    assert said_of([truth_late(one, range(3), d) for one, d in zip(healthy, delays, strict=True)]) == []


@pytest.mark.parametrize("seed", range(20, 26))
def test_slip_and_tolerances_are_not_late(seed):
    contact = ("viscous", "coulomb", "creep", "elastic")[seed % 4]
    data = make_set(hidden_robot(seed, contact=contact), seed, MOTIONS, 2, slip_share=0.25 * (seed % 3))
    assert said_of(data) == []


def test_nothing_of_the_real_recordings_is_late(public_data):
    assert with_late_parts(found := read_recordings([public_data])) == found


def test_a_body_or_radius_of_its_own_is_not_late(healthy):
    def other(one):
        pose = one.truth_pose + np.array([0.0, 0.0, 0.1])
        way = 0.05 * np.exp(1j * pose[:, 2])
        pose[:, 0] += way.real
        pose[:, 1] += way.imag
        return replace(one, truth_pose=pose, wheel_angle_rad=one.wheel_angle_rad * (1.0, 1.05, 1.0, 0.97))

    assert said_of([other(one) for one in healthy]) == []


def test_no_false_correction_of_a_clock_is_made_of_two_late_wheels(healthy, tmp_path, capsys):
    for one in healthy:
        write_plain(tmp_path / f"{one.name}.csv", wheels_late(one, [0, 1], 0.08))
    assert main(["calibrate", str(tmp_path), "--no-validation", "--out", str(tmp_path / "c.toml")]) == 2
    said = capsys.readouterr().err
    assert "FL and BL wheels come" in said
    assert "stamps are corrected" not in said
    assert not (tmp_path / "c.toml").exists()
