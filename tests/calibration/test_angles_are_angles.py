"""Steering angles are angles: whole and half turns change no figure, and a single wrong wheel is named."""

import json
from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import hidden_robot, make_set
from hil.cli import main
from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import write_plain
from hil.datasets.wheel_log import build_recording
from hil.datasets.wrong_signs import check_signs

COUNT_RAD = 2.0 * np.pi / 4096.0


@pytest.fixture(scope="module")
def good():
    return make_set(hidden_robot(5), 5, ("line_x", "line_y", "circle_cw", "rotation_ccw", "scan"), 1)


def principal(angle):
    return np.angle(np.exp(1j * angle))


def flipped(one):
    """Every module half a turn round and driven backwards, with a count of jitter."""
    jitter = COUNT_RAD * np.random.default_rng(1).integers(-1, 2, one.steering_rad.shape)
    return -one.wheel_angle_rad, one.steering_rad + np.pi + jitter


SAME = {
    "flipped": flipped,
    "flipped, wrapped to (-pi, pi]": lambda one: (flipped(one)[0], principal(flipped(one)[1])),
    "in [0, 2 pi)": lambda one: (one.wheel_angle_rad, one.steering_rad % (2.0 * np.pi)),
    "turns counted": lambda one: (
        one.wheel_angle_rad,
        one.steering_rad + 2.0 * np.pi * np.array([1, 0, -2, 30]),
    ),
    "back right flipped, wrapped": lambda one: (
        one.wheel_angle_rad * (1, 1, -1, 1),
        principal(one.steering_rad + np.array([0, 0, np.pi, 0])),
    ),
}


def written(tmp_path, recordings, change):
    for one in recordings:
        angle, steering = change(one)
        write_plain(
            tmp_path / f"{one.name}.csv",
            replace(
                one,
                wheel_angle_rad=angle,
                steering_rad=steering,
                wheel_rate_rad_s=np.full_like(angle, np.nan),
            ),
        )
    return str(tmp_path)


def means(capsys, *args):
    assert main([*args, "--json"]) == 0
    return json.loads(capsys.readouterr().out)["mean"]


@pytest.mark.parametrize("how", SAME)
def test_no_convention_of_steering_changes_a_figure(tmp_path, capsys, good, how):
    """Flipped and wrapped modules had made 66 mm of 0.3, as middles of angles on both sides of pi."""
    (tmp_path / "plain").mkdir(), (tmp_path / "other").mkdir()
    plain = means(capsys, "evaluate", written(tmp_path / "plain", good, as_it_is))
    other = means(capsys, "evaluate", written(tmp_path / "other", good, SAME[how]))
    assert other["rmse_position_m"] == pytest.approx(plain["rmse_position_m"], abs=2e-4)
    assert other["rmse_theta_rad"] == pytest.approx(plain["rmse_theta_rad"], abs=2e-4)


def as_it_is(one):
    return one.wheel_angle_rad, one.steering_rad


def as_read(one, steering, angle=None):
    wheels = np.column_stack([one.wheel_angle_rad if angle is None else angle, steering])
    return build_recording(
        one.name, Log(one.t_s, wheels), Log(one.truth_t_s, one.truth_pose), sources=(f"{one.name}.csv",)
    )


def test_a_steering_axis_that_turns_through_the_wrap_has_no_leap(good):
    one = next(one for one in good if one.motion == "scan")
    shifted = one.steering_rad + np.array([2.0, 0.0, 0.0, 0.0])
    found = as_read(one, principal(shifted), one.wheel_angle_rad)
    np.testing.assert_allclose(
        np.diff(found.steering_rad, axis=0), np.diff(one.steering_rad, axis=0), atol=1e-12
    )


@pytest.mark.parametrize(("factor", "unit"), [(180.0 / np.pi, "degrees"), (0.5 / np.pi, "revolutions")])
def test_another_unit_of_steering_is_named_where_it_was_measured(good, factor, unit):
    one = next(one for one in good if one.motion == "rotation_ccw")
    with pytest.raises(
        DataError, match=rf"^rotation_ccw_1\.csv: steering angles \(delta\) seem to be in {unit}"
    ):
        as_read(one, one.steering_rad * factor)


def changed(one, wheel, rolled=1.0, steered=1.0, further=0.0):
    angle, steering = one.wheel_angle_rad.copy(), one.steering_rad.copy()
    angle[:, wheel] *= rolled
    steering[:, wheel] = steered * steering[:, wheel] + further
    return as_read(one, steering, angle)


WRONG = {
    r"the BR wheel \(phi3, delta3\) alone .* agree if phi3 had the other sign or delta3 were half a turn": {
        "wheel": 2,
        "rolled": -1.0,
    },
    r"the FR wheel \(phi4, delta4\) alone .* agree if phi4 had the other sign or delta4 were half a turn": {
        "wheel": 3,
        "further": np.pi,
    },
    r"the FL wheel \(phi1, delta1\) alone .* would agree if delta1 had the other sign": {
        "wheel": 0,
        "steered": -1.0,
    },
    r"the BL wheel \(phi2, delta2\) alone .* would agree if delta2 were -(39|4[01]) deg further": {
        "wheel": 1,
        "further": 0.7,
    },
    r"the BL wheel \(phi2, delta2\) alone .* would agree if phi2 grew by 0\.(49|5)\d* times": {
        "wheel": 1,
        "rolled": 2.0,
    },
    r"the FL wheel \(phi1, delta1\) alone .* phi1, which hardly changes, followed its wheel": {
        "wheel": 0,
        "rolled": 1e-9,
    },
}


@pytest.mark.parametrize("said", WRONG)
def test_a_single_wrong_wheel_is_named_with_what_is_wrong(good, said):
    with pytest.raises(DataError, match=said):
        check_signs([changed(one, **WRONG[said]) for one in good], Nominal())


def test_two_exchanged_wheels_are_named(good):
    order = [3, 1, 2, 0]
    turning = [one for one in good if one.motion in ("circle_cw", "rotation_ccw")]
    wrong = [as_read(one, one.steering_rad[:, order], one.wheel_angle_rad[:, order]) for one in turning]
    with pytest.raises(
        DataError, match=r"the FL and FR wheels are exchanged \(phi1, delta1 for phi4, delta4\)"
    ):
        check_signs(wrong, Nominal())
