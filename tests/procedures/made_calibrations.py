"""Calibrations as files, without a fit."""

import numpy as np

from hil.calibration.calibration_file import CalibrationFile
from hil.calibration.usability_check import made_for
from hil.config.loading import load_bench

CONFIG = load_bench("emulated_floor")


def made(radius_m=0.0255, verdict="PASS", config=CONFIG, **changes):
    """A calibration of a bench's robot, with one radius for all wheels."""
    robot = config.robot
    four = {"x_w_m": robot.wheel_x_m, "y_w_m": robot.wheel_y_m}
    tree = {
        "schema": 1,
        "version": 1,
        "created": "2026-01-01T00:00:00",
        "method": "lm",
        "setting": "custom",
        "model": "exact",
        "signal": "position",
        "std": {},
        "cost_before": 2.0,
        "cost_after": 1.0,
        "parameters": {**four, "r_m": (radius_m,) * 4, "delta0_rad": (0.01, 0.0, -0.01, 0.0)},
        "nominal": {**four, "r_m": robot.wheel_radius_m},
        "recordings": {},
        "twist_correction": np.eye(3).tolist(),
        "verdict": verdict,
        "made_for": made_for(config),
        "validation": {"fresh_run": {"mean": {"rmse_position_m": 0.0019}}},
        **changes,
    }
    return CalibrationFile.model_validate(tree)
