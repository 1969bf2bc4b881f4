"""The BNO055's offsets, noise and heading come back as they were put in; wrong values are reported."""

import math

import numpy as np
import pytest
from procedure_runs import (
    AS_SHIPPED,
    assert_covered,
    assert_covered_over_twenty_seeds,
    fragment_of,
    part,
    run,
    true_world,
)

from hil.drivers.imu.bno055.calibration import ImuCalibration
from hil.fakes.imu.bno055.chip import Bno055Chip
from hil.fakes.imu.bno055.output_sample import GRAVITY_M_S2

SHORT = {"rest_s": 8.0, "headings": 4, "dwell_s": 1.0, "learn_s": 6.0}
BRIEF = {"rest_s": 5.0, "headings": 4, "heading_deg": 4.0, "dwell_s": 0.5, "learn_s": 4.0}
LSB_DEG_S = 1.0 / 16.0
UNLEARNT = math.exp(-3.0)
"""Share of a gyroscope's offset that a chip which calls itself calibrated lacks: three time constants."""


def hidden(seed):
    """What the chip truly is like, drawn anew for each seed."""
    rng = np.random.default_rng([seed, 77])
    yaw = math.radians(rng.uniform(-3.0, 3.0))
    return {
        "gyro_noise_rad_s": float(rng.uniform(0.001, 0.004)),
        "gyro_bias_rad_s": 0.01,
        "mount_rotation_wxyz": [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)],
    }, yaw


def recover(seed, folder):
    """(errors over stated uncertainties, run) of one seed."""
    truth, yaw = hidden(seed)
    overrides = AS_SHIPPED | {"emulation.imu": truth}
    done = run("imu_calibration", folder, SHORT, seed=seed, overrides=overrides)
    assert done.result.verdict.value in ("PASS", "MARGINAL"), done.failed or done.result.error
    done.assert_held()
    offsets = part(true_world("emulated", seed, overrides), Bno055Chip).sensors.true_offsets
    stored = np.array([done.values[f"gyro_offset_{a}"] for a in "xyz"])
    true = np.degrees(offsets.gyroscope)
    assert (np.abs(stored - true) <= LSB_DEG_S / 2 + UNLEARNT * np.abs(true)).all()
    density = math.degrees(truth["gyro_noise_rad_s"]) * 0.1
    density = math.hypot(density, LSB_DEG_S / math.sqrt(12.0) * 0.1)
    x, y, _ = offsets.accelerometer
    angles = np.radians(np.linspace(-10.0, 10.0, 4)) + yaw
    heading = np.arctan2(np.sin(angles) * GRAVITY_M_S2 - y, np.cos(angles) * GRAVITY_M_S2 + x) - angles + yaw
    return [
        (done.values["gyro_noise"] - density) / done.values["gyro_noise_uncertainty"],
        (done.values["heading_offset"] - np.degrees(heading.mean()))
        / done.values["heading_offset_uncertainty"],
    ], done


def test_imu_offsets_noise_and_heading_come_back(tmp_path):
    ratios, done = recover(1, tmp_path / "run")
    assert_covered(ratios, few=True)
    fragment = fragment_of(tmp_path / "run")["imu"]
    stored = ImuCalibration.load(tmp_path / "run" / fragment["calibration_file"])
    assert [c * LSB_DEG_S for c in stored.gyroscope_offset] == [
        done.values[f"gyro_offset_{a}"] for a in "xyz"
    ]
    before, after = abs(done.values["heading_offset"]), abs(done.values["corrected_heading"])
    assert after < 0.15 < before
    assert done.values["restored_difference"] == 0.0


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_imu_truth_lies_within_the_stated_intervals_over_twenty_seeds(tmp_path):
    assert_covered_over_twenty_seeds(recover, tmp_path)


@pytest.mark.long
def test_a_gyro_that_turns_while_the_robot_rests_fails(tmp_path):
    done = run("imu_calibration", tmp_path / "run", BRIEF, faults=("imu:wrong,rate_rad_s=0.05",))
    assert done.result.exit_code == 1
    assert "gyro_bias" in done.failed
    done.assert_held()


@pytest.mark.parametrize("fault", ["imu:stuck@4", pytest.param("imu:off@4", marks=pytest.mark.long)])
def test_an_imu_that_stops_measuring_ends_the_run(tmp_path, fault):
    done = run("imu_calibration", tmp_path / "run", SHORT, faults=(fault,))
    assert done.result.exit_code == 3
    assert done.result.error.step == "rest"
    assert "imu" in done.result.error.message
    done.assert_held()


def test_imu_calibration_refuses_a_floor(tmp_path):
    done = run("imu_calibration", tmp_path / "run", SHORT, bench="emulated_floor")
    assert done.result.exit_code == 2
    assert not done.source.benches


def test_a_gyro_with_a_dead_zone_is_calibrated_but_for_what_cannot_be_known(tmp_path):
    """It reports nothing below 3 deg/s: no noise and no bias, and the turns of the robot all the same."""
    done = run("imu_calibration", tmp_path, BRIEF, overrides={"emulation.imu.gyro_dead_zone_rad_s": 0.052})
    assert done.result.verdict.value == "MARGINAL", done.failed or done.result.error
    assert done.values["gyro_noise"] == 0.0
    assert 0.85 < done.values["gyro_response"] < 1.0
    assert any("dead zone" in note for note in done.result.facts["notes"])
    kept = done.result.facts["record"]
    assert kept is None or "gyro_noise" not in str(kept)


def test_a_gyro_that_shows_no_turn_at_all_fails(tmp_path):
    done = run("imu_calibration", tmp_path, BRIEF, overrides={"emulation.imu.gyro_dead_zone_rad_s": 3.0})
    assert done.result.verdict.value == "FAIL"
    assert "gyro_response" in done.failed
