"""A sensor is added to the filter by one file, and a line in the list and the functions by number."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

COMPASS = '''
"""Compass: the heading in the wall frame."""

import math

from hil.core.named_records import Record
from hil.estimator.sensors.sensor import (
    DUPLICATE, USED, Tally, account_together, is_repeated, no_frame, undo_nothing,
)
from hil.estimator.state_vector import THETA
from hil.support.numba_jit import inner

NAME = "compass"
NONLINEAR = False
ANGLE_ROW = 0
GATED_TOGETHER = False
START = {"t_ns": -1.0, "tally.nis_mean": 1.0}
FIGURES = {"rejected_compass": "tally.rejected", "nis_compass": "tally.nis"}

new_frame = no_frame
undo = undo_nothing


class Parameters(Record):
    heading: float


class Memory(Record):
    t_ns: float
    tally: Tally


class Row(Record):
    heading_rad: float


def is_used(config):
    return True


def values(config, geometry, surface):
    return {"heading": 0.01**2}


def pack(sample):
    return (sample.heading_rad,) if math.isfinite(sample.heading_rad) else "not_finite"


@inner
def admit(t_ns, m, row, par):
    return DUPLICATE if is_repeated(t_ns, m.t_ns) else USED


@inner
def observe(t_ns, m, row, par, z, var, aux):
    z[0], var[0] = row.heading_rad, par.heading
    return 1


@inner
def predicted(x, aux, par, out):
    out[0] = x[THETA]


@inner
def jacobian(x, aux, par, h):
    h[0, THETA] = 1.0


@inner
def account(m, nu, nis, var, count, gate, samples):
    return account_together(m.tally, nis, var, count, gate, samples)


@inner
def reanchor(limit, t_ns, p, m, par):
    if m.tally.in_row >= limit:
        m.tally.in_row = 0.0
        p[THETA, THETA] += 1.0
    return False


@inner
def remember(t_ns, x, p, m, row, par):
    m.t_ns = t_ns
'''

RUN = """
from dataclasses import dataclass
import numpy as np
from hil.config.estimator import EstimatorConfig
from hil.estimator import make_estimator
from hil.estimator.smoother import smooth
from hil.robot.kinematics import WheelGeometry
from hil.core.signals import Measurements, RobotState, Stamp

@dataclass(frozen=True)
class Heading:
    stamp: Stamp
    heading_rad: float

@dataclass(frozen=True)
class WithCompass(Measurements):
    compass: tuple = ()

def cycle(k):
    t_ns = 10_000_000 * (k + 1)
    turned = [0.2, 0.2 + 2.0 * np.pi, 0.2, np.nan, 0.2, 3.0][k % 6]  # a full turn more, none, an outlier
    return WithCompass(k, t_ns, compass=(Heading(Stamp(t_ns, t_ns, k), turned),))

sigma = np.array([1e-3, 1e-3, 0.14, 1e-3, 1e-3, 1e-3])
start = RobotState(0, np.zeros(3), np.zeros(3), np.diag(sigma**2))
cycles = [cycle(k) for k in range(60)]
for kind in ("ekf", "ukf"):
    config = EstimatorConfig(kind=kind)
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="wall")
    estimator.reset(start)
    for m in cycles:
        state = estimator.update(m)
    d = state.diagnostics
    print(state.pose_body_in_wall[2], state.covariance[2, 2] ** 0.5, d["rejected_compass"],
          d["rejected_not_finite"], d["age_compass_s"])
print(smooth(config, WheelGeometry.nominal(), "wall", cycles, start)[0].pose_body_in_wall[2])
"""


def of_compass(call):
    """The same call of the new sensor, with its own part of memory, row and parameters."""
    return call.replace("mocap", "compass")


def test_a_sensor_is_added_by_a_file_and_a_line(tmp_path):
    """A compass: filtered, gated, counted, smoothed, without another edit of the package."""
    shutil.copytree(ROOT / "hil", tmp_path / "hil", ignore=shutil.ignore_patterns("__pycache__"))
    room = tmp_path / "hil" / "estimator" / "sensors"
    (room / "compass.py").write_text(COMPASS)
    text = (room / "__init__.py").read_text()
    line = "SENSORS: tuple[Sensor, ...] = (wheels, gyro, tracker, mocap)\n"
    assert line in text
    added = "from hil.estimator.sensors import compass\n" + line.replace("mocap)", "mocap, compass)")
    by_number = re.compile(r"^(?:    else:\n    )?    ((?:return )?mocap\..*)$", re.MULTILINE)
    chain = by_number.sub(lambda m: f"    if number == 4:\n        {m[1]}\n    {of_compass(m[1])}", text)
    (room / "__init__.py").write_text(chain.replace(line, added))
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1"},
    )
    assert done.returncode == 0, done.stderr
    *filtered, smoothed = [[float(v) for v in line.split()] for line in done.stdout.splitlines()]
    assert len(filtered) == 2
    for heading, sigma, rejected, not_finite, age_s in filtered:
        assert heading == pytest.approx(0.2, abs=0.01)
        assert sigma < 0.01
        assert (rejected, not_finite) == (10.0, 10.0)
        assert age_s == 0.0
    assert smoothed[0] == pytest.approx(0.2, abs=0.01)
