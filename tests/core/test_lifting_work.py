"""The drives' work against the weight: a robot that speeds up lifts no more than one that rolls evenly."""

import numpy as np
import pytest

from hil.core.signals import Inputs, Measurements, ServoSample, Stamp, Status, WheelMeasurement
from hil.loop.checks.lifting_work import Lifted, WeightCheck
from hil.loop.cycle_data import Cycle
from hil.robot.statics import GRAVITY_M_S2

PERIOD_S = 0.01
MASS_KG, PUSH_N, N_M_A, RADIUS_M, INERTIA_KG_M2 = 3.25, 22.3, 2.4, 0.0254, 12.4e-3
LOSS_N_M, LOSS_N_M_S = 0.05, 0.025
"""Losses of one drive, at any speed and by speed: somewhat more than the data sheet's rows have."""


def climbed(said_kg, rates_rad_s, inertia_kg_m2=INERTIA_KG_M2):
    """The check of a robot that climbs with these wheel rates, one a period, and the events that it gave."""
    check = WeightCheck(Lifted(said_kg, 1.0, PUSH_N, N_M_A, RADIUS_M, INERTIA_KG_M2), stops=False)
    lifting_n_m = 0.25 * (MASS_KG * GRAVITY_M_S2 - PUSH_N) * RADIUS_M
    speeding_kg_m2 = inertia_kg_m2 + 0.25 * MASS_KG * RADIUS_M**2
    events, angle, before = [], 0.0, rates_rad_s[0]
    for k, rate in enumerate(rates_rad_s):
        angle += 0.5 * (rate + before) * PERIOD_S
        torque = lifting_n_m + LOSS_N_M + LOSS_N_M_S * rate + speeding_kg_m2 * (rate - before) / PERIOD_S
        before, t_ns = rate, round(k * PERIOD_S * 1e9)
        stamp, four = Stamp(t_ns, t_ns, k), np.ones(4)
        current = np.concatenate([torque / N_M_A * four, np.zeros(4)])
        sample = ServoSample(stamp, np.zeros(8), np.zeros(8), current, (Status.OK,) * 8)
        wheels = WheelMeasurement(stamp, angle * four, rate * four, np.zeros(4), (True,) * 4)
        cycle = Cycle(Inputs(k, t_ns, servos=(sample,)), Measurements(k, t_ns, wheels=(wheels,)))
        check.on_samples(cycle)
        events += cycle.events
    return check, events


EVEN = np.full(300, 2.0)
SPEEDING = np.concatenate([np.full(50, 0.7), np.linspace(0.7, 4.6, 60), np.full(300, 4.6)])
SLOWING = np.concatenate([np.full(35, 4.6), np.linspace(4.6, 0.7, 60), np.full(400, 0.7)])


@pytest.mark.parametrize("rates", [EVEN, SPEEDING, SLOWING], ids=["even", "speeding", "slowing"])
@pytest.mark.parametrize("inertia", [0.0, INERTIA_KG_M2, 2.0 * INERTIA_KG_M2])
def test_a_right_weight_is_confirmed_however_the_robot_speeds_up(rates, inertia):
    check, events = climbed(MASS_KG, rates, inertia)
    assert events == []
    assert abs(check.off_share) < 0.1


@pytest.mark.parametrize("rates", [EVEN, SPEEDING, SLOWING], ids=["even", "speeding", "slowing"])
@pytest.mark.parametrize("said_kg", [0.6 * MASS_KG, 1.6 * MASS_KG])
def test_a_wrong_weight_is_told_however_the_robot_speeds_up(rates, said_kg):
    check, (event,) = climbed(said_kg, rates)
    assert "robot.mass_kg" in event.key
    assert (check.off_share + 1.0) * said_kg == pytest.approx(MASS_KG, rel=0.12)
