"""How the sensors fit: means over drives by a filter, of every bench of a run, beside their band."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core.signals import (
    CycleRecord,
    Inputs,
    Measurements,
    Reference,
    RobotState,
    ServoSetpoint,
    WheelSetpoint,
)
from hil.procedure.fit_history import FitHistory

FOUR = np.zeros(4)


def cycle(number, *, driven=True, **nis):
    t_ns = number * 10_000_000
    figures = {f"nis_mean_{name}": value for name, value in nis.items()} | {f"age_{n}_s": 0.0 for n in nis}
    reference = Reference(0.0, np.zeros(3), np.zeros(3), np.zeros(2)) if driven else None
    return CycleRecord(
        number,
        t_ns,
        t_ns,
        Inputs(number, t_ns),
        Measurements(number, t_ns),
        RobotState(t_ns, np.zeros(3), np.zeros(3), np.eye(6), figures),
        reference,
        WheelSetpoint(FOUR, FOUR),
        ServoSetpoint(FOUR, FOUR),
    )


def watched(begin=0, end=600, **nis):
    history = FitHistory()
    for number in range(begin, end):
        history.write(cycle(number, **nis))
    return history


def test_each_sensor_is_named_by_how_far_it_is_off():
    said = {row[0]: row[3] for row in watched(wheels=0.9, gyro=0.04, tracker=9.0).rows()}
    assert "as assumed" in said["wheels"]
    assert "1/5.0" in said["gyro"]
    assert "3.0 times" in said["camera"]


def test_the_beginning_of_a_drive_and_rests_do_not_count():
    history = FitHistory()
    for number in range(199):
        history.write(cycle(number, gyro=50.0))
    for number in range(200, 800):
        history.write(cycle(number, driven=False, gyro=50.0))
    for number in range(1000, 1600):
        history.write(cycle(number, gyro=50.0 if number < 1190 else 1.0))
    assert history.means()["gyro"] == pytest.approx(1.0)


def test_benches_of_other_processes_count_by_their_cycles():
    first, second = watched(gyro=1.0), watched(gyro=3.0)
    first.follow(second)
    assert first.means()["gyro"] == pytest.approx(2.0)


def test_a_silent_sensor_has_no_row():
    assert list(watched().rows()) == []
