"""Wheel angles that were integrated from rounded rates are named; counted ones never are."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.datasets.integrated_angles import with_integrated_angles
from hil.datasets.plain_csv import read_plain, write_plain
from tests.calibration.spoilt_sets import make_drives


@pytest.fixture(scope="module")
def healthy():
    return make_set(hidden_robot(4), 4, (*MOTIONS, "arc"), 1)


def integrated(one, rate):
    lasts_s = np.diff(one.t_s, prepend=one.t_s[0])
    return replace(one, wheel_angle_rad=np.cumsum(rate * lasts_s[:, None], axis=0))


def of_register(one):
    """The register of the servos, which truncates."""
    return integrated(one, one.wheel_rate_rad_s)


def rounded_to(unit_rad_s, how=np.round):
    def spoil(one):
        rate = np.gradient(one.wheel_angle_rad, one.t_s, axis=0)
        mean = np.ones(15) / 15
        smooth = np.column_stack([np.convolve(column, mean, "same") for column in rate.T])
        return integrated(one, how(smooth / unit_rad_s) * unit_rad_s)

    return spoil


@pytest.mark.parametrize(
    "spoil",
    [of_register, rounded_to(0.024), rounded_to(0.024, np.trunc), rounded_to(0.1), rounded_to(0.1, np.trunc)],
    ids=["register", "rounded 0.024", "cut 0.024", "rounded 0.1", "cut 0.1"],
)
def test_angles_of_rounded_rates_are_named_with_their_unit(healthy, spoil):
    found = with_integrated_angles([spoil(one) for one in healthy])
    said = [one.contradictions[0] for one in found if one.contradictions]
    assert 2 * len(said) > len(healthy)
    unit = float(said[0].split("multiples of ")[1].split()[0])
    assert min(abs(unit - 0.024), abs(unit - 0.1)) < 5e-4


def test_counted_angles_are_left_alone(healthy, tmp_path):
    assert with_integrated_angles(healthy) == healthy
    drives = [read_plain(one.write(tmp_path)) for one in make_drives(310)]
    assert with_integrated_angles(drives) == drives


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_no_count_of_an_encoder_is_taken_for_a_unit_of_rates(healthy, bits):
    count_rad = 2.0 * np.pi / 2**bits
    made = [
        replace(one, wheel_angle_rad=np.round(one.wheel_angle_rad / count_rad) * count_rad) for one in healthy
    ]
    assert with_integrated_angles(made) == made


def test_angles_without_any_rounding_are_left_alone(healthy):
    """As a simulation gives them: at a steady rate all steps are the same."""

    def smooth(one):
        t_s = one.t_s - one.t_s[0]
        speed = np.clip(np.minimum(t_s, t_s[-1] - t_s) - 1.0, 0.0, 0.7)
        rate = np.outer(speed, np.abs(one.wheel_angle_rad[-1] - one.wheel_angle_rad[0]) / t_s[-1])
        return integrated(one, rate)

    made = [smooth(one) for one in healthy]
    assert with_integrated_angles(made) == made


def test_no_calibration_is_written_of_integrated_angles(healthy, tmp_path, capsys):
    for one in healthy:
        write_plain(tmp_path / f"{one.name}.csv", of_register(one))
    assert main(["calibrate", str(tmp_path), "--no-validation", "--out", str(tmp_path / "c.toml")]) == 2
    assert "integrated from rounded rates" in capsys.readouterr().err
    assert not (tmp_path / "c.toml").exists()
