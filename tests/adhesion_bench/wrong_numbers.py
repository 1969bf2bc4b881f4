"""Wrong numbers for fan, propellers and load cells: each case, how it ends, and what is red by the truth.

A case is a bench file that differs from the emulated hardware (`[emulation.*]` has the true values), or a
controller that reports something else than is true, at some moment.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np

import hil
from hil.core.errors import HilError
from hil.fault_matrix.possible_hold import can_be_held
from hil.faults.fault import parse_fault
from hil.robot.trajectories import line

FACTORS = (-1.0, 0.3, 0.5, 0.67, 0.8, 0.9, 1.1, 1.2, 1.3, 1.6, 2.0, 3.0, 4.0)
RATIOS = (0.5, 0.67, 0.8, 1.25, 1.5, 2.0)
POLES = tuple(n for k in range(1, 16) for n in (k, -k))
MOMENTS_S = (0.0, 1.5, 3.6, 14.0)
"""Before, in motion, in the hold check, after the close."""
BRIEF = {"exit.look_after_s": 1.0, "loop.rate_hz": 50.0}
ON_VESCS = {"thrust": {"backend": "emulated", "model": "vesc"}}
CLIMB = line((0, 0, 0), (0.12, 0, 0), duration_s=2.5)
_RATED = {"rated_force_n": 45.0, "rated_rpm": 30_000.0}
_FULL_N = 39.7
_STEP_NS, _AFTER_NS = 100_000_000, 3_000_000_000


class Case(NamedTuple):
    """What is wrong: keys of the bench file (true values under `emulation`), faults."""

    name: str
    overrides: dict
    faults: tuple = ()


def _benches(worlds=("own", "mujoco")):
    """Name and keys of each bench: both physics, with and without load cells."""
    for plant, cells in product(worlds, (True, False)):
        keys = {**BRIEF, "emulation.plant": plant}
        yield f"{plant} {'cells' if cells else 'no cells'}", keys if cells else {**keys, "load_cells": None}


def cases():
    """All cases."""
    for bench, keys in _benches():
        for factor, at_s in product(FACTORS, MOMENTS_S):
            yield Case(
                f"fan x {factor:g} at {at_s:g} s, {bench}", keys, (f"adhesion:wrong@{at_s},factor={factor}",)
            )
        for poles in POLES:
            if poles != 3:
                yield Case(f"fan poles {poles}, {bench}", {**keys, "emulation.adhesion.pole_pairs": poles})
        for key, ratio in product(_RATED, RATIOS):
            true = {f"emulation.adhesion.{key}": _RATED[key] / ratio}
            yield Case(f"fan {key} x {ratio:g}, {bench}", {**keys, **true})
        for ratio in RATIOS:
            true = {"emulation.thrust.full_force_n": _FULL_N / ratio}
            yield Case(f"propellers' full force x {ratio:g}, {bench}", {**keys, **true})
            yield Case(f"propellers' full force on VESCs x {ratio:g}, {bench}", {**keys, **ON_VESCS, **true})
        for factor, at_s in product([f for f in FACTORS if f > 0.0], MOMENTS_S):
            faults = (f"thrust:wrong@{at_s},factor={factor}",)
            yield Case(f"propellers x {factor:g} at {at_s:g} s, {bench}", keys, faults)
            yield Case(
                f"propellers on VESCs x {factor:g} at {at_s:g} s, {bench}", {**keys, **ON_VESCS}, faults
            )
        for poles in POLES:
            if poles != 7:
                true = {**ON_VESCS, "emulation.thrust.pole_pairs": poles}
                yield Case(f"propellers' poles {poles}, {bench}", {**keys, **true})
        for command, factor in product(("current", "rpm"), (0.5, 2.0)):
            faults = (f"adhesion:wrong@1.5,factor={factor}",)
            yield Case(
                f"fan by {command} x {factor:g}, {bench}", {**keys, "adhesion.command": command}, faults
            )
        by_need = {**keys, "adhesion.by_need": True}
        yield Case(f"fan by need x 2, {bench}", by_need, ("adhesion:wrong@1.5,factor=2",))


class End(NamedTuple):
    """How a case ended, by the world's truth.

    Attributes:
        stop: reason or kind of the error that ended the run; empty for none.
        text: that error.
        held: how the bench says that it left the robot.
        fallen: whether the robot has fallen.
        moved_m: distance after the close.
        force_n, need_n: adhesion at the close, and what the robot needed then.
        least_n: lowest adhesion until the end.
        thrust_n: push of the propellers at the end.
        could: whether anything could have held the robot: propellers that push by a far wrong force leave
            no time, and after the close nothing sees a slide.
        told: number of warnings and errors that the bench told.
    """

    stop: str
    text: str
    held: object
    fallen: bool
    moved_m: float
    force_n: float
    need_n: float
    least_n: float
    thrust_n: float
    could: bool
    told: int


def drive(case, seed):
    """Drive a case, close the bench, and wait until its last fault has begun three seconds before."""
    error, lowest = None, [math.inf]
    bench = hil.open_bench("emulated", seed=seed, overrides=case.overrides, faults=list(case.faults))
    world = bench.world

    def watch(_record=None):
        world.sync_plant()
        lowest.append(world.plant.truth().adhesion_n)

    try:
        with bench:
            bench.drive(CLIMB, feedback="ekf", hold_s=0.3, on_cycle=watch)
    except HilError as found:
        error = found
    watch()
    closed, closed_ns = world.plant.truth(), world.now_ns
    need_n = needed_n(world, closed.thrust_n)
    begun_ns = max((fault.start_ns for fault in bench.faults), default=0)
    end_ns = max(world.now_ns, begun_ns) + _AFTER_NS
    while world.now_ns < end_ns:
        world.advance_to(world.now_ns + _STEP_NS)
        watch()
    end = world.plant.truth()
    moved_m = float(np.hypot(*(end.pose_body_in_wall - closed.pose_body_in_wall)[:2]))
    stop = "" if error is None else getattr(error, "reason", type(error).__name__)
    return End(
        stop,
        str(error or ""),
        bench.held,
        bool(end.fallen),
        moved_m,
        closed.adhesion_n,
        need_n,
        min(lowest),
        end.thrust_n,
        can_be_held(true_share(case), watched=begun_ns < closed_ns),
        len(bench.seen.rows()),
    )


def true_share(case):
    """True push of the propellers over the asked one, by the numbers that the case makes wrong."""
    keys = case.overrides
    share = keys.get("emulation.thrust.full_force_n", _FULL_N) / _FULL_N
    share *= (7 / keys.get("emulation.thrust.pole_pairs", 7)) ** 2
    if "thrust" not in keys:  # a Teensy's propellers push wrongly, VESCs report wrongly
        share *= math.prod(
            f.option("factor", 1.0) for f in map(parse_fault, case.faults) if f.device == "thrust"
        )
    return share


def needed_n(world, thrust_n):
    """Adhesion that this world's robot needs upright, by statics with its true mass and friction."""
    true = world.plant.parameters
    return abs(true.mass_kg * 9.81 - thrust_n) / true.contact.friction


def red(end):
    """What is wrong with how a case ended, as texts; empty for nothing."""
    found = []
    if end.fallen and end.could:
        found.append("fell")
    if end.held.state == "HELD" and end.held.confirmed and end.force_n < end.need_n:
        found.append(f"HELD as confirmed at {end.force_n:.1f} N of {end.need_n:.1f} N")
    if end.held.state == "HELD" and end.moved_m > 0.005 and end.could:
        found.append(f"moved {1e3 * end.moved_m:.0f} mm after HELD")
    if abs(end.thrust_n) > 100.0:
        found.append(f"{end.thrust_n:.0f} N of push are left on")
    return found
