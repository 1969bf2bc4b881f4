"""Columns that are late, or exchanged, are named; those of good recordings are not."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.datasets.cleaning import Log
from hil.datasets.misplaced_columns import with_misplaced_columns
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import read_plain, write_plain
from hil.datasets.wheel_log import build_recording
from tests.calibration.spoilt_sets import CORNERS, RADIUS_M, make_drives

FL, BL, BR, FR = range(4)
LATE_S = 0.5


def driven(name, ahead, left, turn, seed):
    """A drive of a perfect robot at these rates, m/s and rad/s, at rest before and after, with noise."""
    rng, t_s = np.random.default_rng(seed), np.arange(0.0, 22.0, 0.02)
    speed = np.clip(np.minimum(t_s - 1.0, 21.0 - t_s) / 0.5, 0.0, 1.0)
    at = np.clip(t_s, 1.0, 21.0)
    body = np.column_stack([rate(at) + 0.0 * at for rate in (ahead, left, turn)])
    vx, vy = body[:, :1] - CORNERS[:, 1] * body[:, 2:], body[:, 1:2] + CORNERS[:, 0] * body[:, 2:]
    delta = np.unwrap(np.arctan2(vy, vx), axis=0)
    moves = speed[:, None] * body * 0.02
    phi = np.cumsum(np.hypot(vx, vy) * speed[:, None] * 0.02 / RADIUS_M, axis=0)
    theta = np.cumsum(moves[:, 2])
    way = np.cumsum((moves[:, 0] + 1j * moves[:, 1]) * np.exp(1j * theta))
    pose = np.column_stack([way.real, way.imag, theta]) + rng.normal(0.0, (1e-4, 1e-4, 4e-4), (len(t_s), 3))
    wheels = np.column_stack([phi, delta]) + rng.normal(0.0, 4e-4, (len(t_s), 8))
    return build_recording(name, Log(t_s, wheels), Log(t_s, pose), motion=name[:-2])


@pytest.fixture(scope="module")
def healthy():
    """Curves of which the rates of all wheels, and their steering, differ and change."""
    shapes = {
        "weave": (lambda t: 0.05, lambda t: 0.03 * np.sin(t), lambda t: 0.08 * np.cos(0.7 * t)),
        "curl": (lambda t: 0.04, lambda t: 0.02, lambda t: 0.2 * np.sin(0.4 * t)),
        "line": (lambda t: 0.05, lambda t: 0.0, lambda t: 0.0),
    }
    return [driven(f"{name}_{k}", *shape, k) for name, shape in shapes.items() for k in (1, 2)]


def late(one, phi=(), delta=(), truth=()):
    """These columns are stamped half a second late."""
    angle, steering, pose = one.wheel_angle_rad.copy(), one.steering_rad.copy(), one.truth_pose.copy()
    for values, t_s, columns in (
        (angle, one.t_s, phi),
        (steering, one.t_s, delta),
        (pose, one.truth_t_s, truth),
    ):
        for k in columns:
            values[:, k] = np.interp(t_s - LATE_S, t_s, values[:, k])
    return replace(one, wheel_angle_rad=angle, steering_rad=steering, truth_pose=pose)


def ordered(one, phi=range(4), delta=range(4)):
    """Drive and steering columns in another order."""
    angle, steering = one.wheel_angle_rad[:, list(phi)], one.steering_rad[:, list(delta)]
    return replace(one, wheel_angle_rad=angle, steering_rad=steering)


ALL = range(4)


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda one: late(one, delta=[BL]), "its column delta2 comes 0.50 s later"),
        (lambda one: late(one, phi=[BR]), "its column phi3 comes 0.50 s later"),
        (lambda one: late(one, delta=ALL), "its steering angles (delta) come 0.50 s later than"),
        (lambda one: late(one, phi=ALL), "its wheel angles (phi) come 0.50 s later than"),
        (lambda one: late(one, phi=ALL, truth=range(3)), "its steering angles (delta) come 0.50 s earlier"),
        (lambda one: late(one, delta=[FR], phi=[FR]), "its columns of the FR wheel (phi, delta) come 0.50 s"),
        (lambda one: late(one, truth=[2]), "the heading of its ground truth comes 0.50 s later"),
        (lambda one: late(one, truth=[0, 1]), "the positions of its ground truth come 0.50 s later"),
        (lambda one: ordered(one, phi=(BL, FL, BR, FR)), "phi1 and phi2 are exchanged"),
        (lambda one: ordered(one, delta=(FL, FR, BR, BL)), "delta2 and delta4 are exchanged"),
        (lambda one: ordered(one, phi=(BL, BR, FR, FL)), "phi1 to phi4 hold the angles of BL, BR, FR, FL"),
    ],
)
def test_a_column_that_is_late_or_exchanged_is_named_in_all_recordings(healthy, spoil, named):
    """Also in the straight lines, which do not show it."""
    found = with_misplaced_columns([spoil(one) for one in healthy], Nominal())
    assert all(named in one.contradictions[0] for one in found)


def test_a_fault_of_one_recording_is_named_there_alone(healthy):
    found = with_misplaced_columns([late(healthy[0], delta=[BL]), *healthy[1:]], Nominal())
    assert [one.name for one in found if one.contradictions] == [healthy[0].name]


def test_columns_exchanged_in_one_repetition_are_named_there_alone():
    """Recordings of the other repetition say nothing is exchanged; lines follow their own repetition."""
    data = make_set(hidden_robot(37, contact="viscous"), 37, MOTIONS, 2)
    spoilt = [ordered(one, delta=(FL, BR, BL, FR)) if one.name.endswith("_2") else one for one in data]
    found = with_misplaced_columns(spoilt, Nominal())
    assert [one.name for one in found if one.contradictions] == [
        one.name for one in data if one.name.endswith("_2")
    ]
    assert all("delta2 and delta3 are exchanged" in said for one in found for said in one.contradictions)


@pytest.mark.parametrize("spoil", [lambda one: one, lambda one: late(one, truth=range(3))])
def test_good_columns_and_late_ground_truth_are_left_alone(healthy, spoil):
    """Stamps of the whole ground truth are corrected elsewhere."""
    found = with_misplaced_columns([spoil(one) for one in healthy], Nominal())
    assert not any(one.contradictions for one in found)


@pytest.mark.parametrize("seed", [704, 711])
def test_tolerances_and_slip_are_no_misplaced_columns(tmp_path, seed):
    """Sets of dry friction, creep and lost ways, of which slip and zeros came nearest to such a cause."""
    drives = [read_plain(one.write(tmp_path)) for one in make_drives(seed)]
    assert not any(one.contradictions for one in with_misplaced_columns(drives, Nominal()))


@pytest.mark.parametrize("spoil", [lambda one: late(one, delta=[BL]), lambda one: ordered(one, (1, 0, 2, 3))])
def test_no_calibration_is_written_from_misplaced_columns(healthy, tmp_path, capsys, spoil):
    for one in healthy:
        write_plain(tmp_path / f"{one.name}.csv", spoil(one))
    assert main(["evaluate", str(tmp_path)]) == 2
    assert main(["calibrate", str(tmp_path), "--no-validation", "--out", str(tmp_path / "c.toml")]) == 2
    assert "curl_1: its column" in capsys.readouterr().err
    assert not (tmp_path / "c.toml").exists()


def test_a_body_of_another_heading_is_no_heading_that_comes_late(healthy):
    """On circles both look nearly alike: it is left to what names headings."""
    bias_rad = (0.1, -0.2, 0.3, 0.05, 0.25, -0.3)
    turned = [
        replace(one, truth_pose=one.truth_pose + np.array([0.0, 0.0, by_rad]))
        for one, by_rad in zip(healthy, bias_rad, strict=True)
    ]
    assert not any(one.contradictions for one in with_misplaced_columns(turned, Nominal()))
    circles = make_set(hidden_robot(3), 3, ("circle_ccw", "circle_cw"), 4)
    turned = [
        replace(one, truth_pose=one.truth_pose + np.array([0.0, 0.0, bias_rad[k % 4]]))
        for k, one in enumerate(circles)
    ]
    assert not any(one.contradictions for one in with_misplaced_columns(turned, Nominal()))
