"""A robot that wrong propellers let slide is held again by fan and propellers, while physics allows it."""

import contextlib
from itertools import product

import numpy as np
import pytest
from wrong_numbers import BRIEF, Case, drive

import hil
from hil.core.clock import nanoseconds
from hil.core.errors import HilError
from hil.fault_matrix.possible_hold import LOST_M, can_be_held, slides_m
from hil.loop.checks.adhesion_limits import SlidePush
from hil.robot.trajectories import line
from tests.selected import every

IN_MOTION_S, IN_THE_CHECK_S = 1.5, 3.6
ASKED_N = 0.7 * 3.25 * 9.81
"""Push that the shipped bench asks for: 0.7 of the weight."""
SETTLES_NS = nanoseconds(1.0)


@pytest.mark.parametrize(
    ("factor", "at_s", "plant"),
    every(3, [*product((0.42, 2.5), (IN_MOTION_S, IN_THE_CHECK_S), ("own", "mujoco"))]),
)
def test_propellers_that_push_wrongly_are_set_against_the_slide(factor, at_s, plant):
    keys = {**BRIEF, "emulation.plant": plant}
    end = drive(Case("", keys, (f"thrust:wrong@{at_s},factor={factor}",)), seed=8901)
    assert not end.fallen
    assert end.held.state == "HELD"
    assert end.moved_m < 0.001
    assert end.told


@pytest.mark.parametrize(
    ("factor", "at_s", "plant"),
    every(5, [*product((3.0, 4.0), (0.0, IN_MOTION_S, IN_THE_CHECK_S), ("own", "mujoco"))]),
)
def test_propellers_that_throw_a_robot_off_are_not_raised_while_it_falls(factor, at_s, plant):
    keys = {**BRIEF, "emulation.plant": plant, "load_cells": None}
    end = drive(Case("", keys, (f"thrust:wrong@{at_s},factor={factor}",)), seed=8900)
    assert end.fallen
    assert end.thrust_n < 1.05 * factor * ASKED_N


def test_propellers_are_not_raised_in_a_fall_nor_once_they_were_lowered_against_a_slide():
    raised, lowered, less_lowered = SlidePush(35.0, True), SlidePush(15.0, False), SlidePush(20.0, False)
    orders = [(raised, True), (raised, False), (lowered, True), (raised, False), (less_lowered, False)]
    bench = hil.open_bench("emulated", seed=8903, overrides=BRIEF)
    given_n, refused = [], []
    with bench:
        for push, falls in orders:
            refused.append(bool(bench.devices.push(push, falls=falls)))
            bench.clock.sleep_until_ns(bench.clock.now_ns() + SETTLES_NS)
            given_n.append(bench.truth().thrust_n)
    assert refused == [True, False, False, True, False]
    assert given_n == pytest.approx([ASKED_N, 35.0, 15.0, 15.0, 15.0], rel=0.05)


@pytest.mark.parametrize("spec", ["tracker:wrong@1.3,drift_x_m_s=-0.2", "mocap:wrong@1.3,offset_m=0.015"])
def test_one_sensor_alone_changes_no_propellers(spec):
    bench = hil.open_bench("emulated", seed=8902, overrides=BRIEF, faults=[spec])
    pushes = []
    with bench:
        with contextlib.suppress(HilError):
            bench.drive(
                line((0, 0, 0), (0.12, 0, 0), duration_s=2.5),
                feedback="ekf",
                on_cycle=lambda _: pushes.append(bench.truth().thrust_n),
            )
        asked_n = np.mean(pushes)
        bench.look()
        assert bench.truth().thrust_n == pytest.approx(asked_n, abs=0.3)


def test_what_can_be_held_is_the_range_where_statics_hold_and_a_margin_of_time():
    statics = [(3.25 * 9.81 + sign * 0.45 * 45.0) / 22.3 for sign in (-1.0, 1.0)]
    assert [slides_m(share) for share in (statics[0] * 1.02, 1.0, statics[1] * 0.98)] == [0.0] * 3
    for share in (statics[0] * 0.98, statics[1] * 1.02):
        assert can_be_held(share)
        assert not can_be_held(share, watched=False)
    assert slides_m(4.0) > LOST_M
