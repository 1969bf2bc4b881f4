"""Coupling of the steering into the drive encoders: read off at rest, refused or taken out, kept in files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.calibration_file import read_calibration
from hil.calibration.synthetic import hidden_robot, make_set
from hil.calibration.usability_check import check_usable
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, DataError
from hil.datasets.azimuth_coupling import Coupling, decoupled
from hil.datasets.plain_csv import write_plain
from hil.robot.kinematics import WheelGeometry

CAD = WheelGeometry.nominal()
TURNS = np.array([0.3, 0.05, -0.2, 1.0])
STEER_S = 1.5


def steered_first(one):
    """A recording that begins with straight wheels, which are steered at rest to where it finds them."""
    begin_s = np.arange(0.0, STEER_S + 1.0, 0.02)
    share = np.clip((begin_s - 0.5) / STEER_S, 0.0, 1.0)
    still = np.ones((len(begin_s), 1))
    columns = {
        "t_s": (begin_s, one.t_s - one.t_s[0] + begin_s[-1] + 0.02),
        "wheel_angle_rad": (still * one.wheel_angle_rad[0], one.wheel_angle_rad),
        "steering_rad": (share[:, None] * one.steering_rad[0], one.steering_rad),
        "wheel_rate_rad_s": (0.0 * still * np.ones(4), one.wheel_rate_rad_s),
        "truth_t_s": (begin_s, one.truth_t_s - one.t_s[0] + begin_s[-1] + 0.02),
        "truth_pose": (still * one.truth_pose[0], one.truth_pose),
    }
    return replace(one, **{name: np.concatenate(parts) for name, parts in columns.items()})


@pytest.fixture(scope="module")
def good():
    data = make_set(hidden_robot(5), 5, ("line_y", "rotation_ccw", "rotation_cw"), 2)
    return [steered_first(one) for one in data]


def coupled(recordings, turns):
    return [
        replace(one, wheel_angle_rad=one.wheel_angle_rad + turns * one.steering_rad) for one in recordings
    ]


@pytest.mark.parametrize("turns", [0.05, 0.3, 1.0, -1.0])
def test_coupling_is_read_off_at_rest_and_refused(good, turns):
    with pytest.raises(DataError, match=rf"by {turns:.3f}, {turns:.3f}, .* of delta: .*--coupling fit"):
        decoupled(coupled(good, turns), CAD, None)


def test_recordings_without_coupling_stay_as_they_are(good):
    assert decoupled(good, CAD, None) == good
    plain = make_set(hidden_robot(7), 7, repetitions=1)
    assert decoupled(plain, CAD, None) == plain


def test_each_wheel_has_its_own_and_it_is_taken_out(good):
    for asked in (Coupling(), Coupling(tuple(TURNS.tolist()))):
        found = decoupled(coupled(good, TURNS), CAD, asked)
        np.testing.assert_allclose(found[0].coupling, TURNS, atol=2e-3)
        for one, other in zip(found, good, strict=True):
            rolled, true = (r.wheel_angle_rad - r.wheel_angle_rad[0] for r in (one, other))
            np.testing.assert_allclose(rolled, true, atol=5e-3)
    with pytest.raises(DataError, match="expected the coupling given"):
        decoupled(coupled(good, TURNS), CAD, Coupling((0.3, 0.3, 0.3, 0.3)))


def test_none_can_be_fitted_where_nothing_is_steered_at_rest():
    lines = make_set(hidden_robot(5), 5, ("line_x",), 1)
    with pytest.raises(
        DataError, match=r"in no recording do all modules turn by 0\.5 rad while the body rests"
    ):
        decoupled(lines, CAD, Coupling())


def test_a_calibration_keeps_what_was_taken_out_and_evaluate_takes_it_out_again(tmp_path, capsys, good):
    data, out = tmp_path / "data", tmp_path / "calibration.toml"
    data.mkdir()
    for one in coupled(good, TURNS):
        write_plain(
            data / f"{one.name}.csv", replace(one, wheel_rate_rad_s=np.full((len(one.t_s), 4), np.nan))
        )
    assert main(["calibrate", str(data), "--no-validation", "--model", "exact", "--out", str(out)]) == 2
    assert "the steering is coupled into the drives" in capsys.readouterr().err
    fit = ["--no-validation", "--model", "exact", "--coupling", "fit", "--out", str(out)]
    assert main(["calibrate", str(data), *fit]) == 0
    file = read_calibration(out)
    np.testing.assert_allclose(file.coupling, TURNS, atol=2e-3)
    with pytest.raises(ConfigError, match="which the bench does not take out"):
        check_usable(file, load_bench("emulated"), str(out))
    capsys.readouterr()
    assert main(["evaluate", str(data), "--calibration", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert any("taken out of phi1 to phi4" in line for line in found["warnings"])
    assert main(["evaluate", str(data), "--coupling", "0.3,much"]) == 2
    assert "neither fit, nor one number, nor four" in capsys.readouterr().err
