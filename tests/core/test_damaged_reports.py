"""Messages that a wire damages are told from what they seem to report."""

from types import SimpleNamespace

import numpy as np
import pytest

import hil
from hil.core.signals import Status
from hil.loop.checks.damaged_reports import DamagedReports
from hil.loop.cycle_data import Cycle
from hil.robot.trajectories import line

RNG = np.random.default_rng(3)


def fan(speed_rpm=30000.0, fet_c=40.0, input_v=22.8):
    return SimpleNamespace(
        status=Status.OK, speed_rpm=speed_rpm, fet_c=fet_c, motor_c=np.nan, input_v=input_v, duty=0.8
    )


def told(samples, stops=()):
    """Events of a run, and the stops of its last cycle; `stops` are those that other checks give there."""
    check, events, cycle = DamagedReports(), [], None
    for k, sample in enumerate(samples):
        found = {"adhesion": (sample,), "load_cells": ()}
        inputs = SimpleNamespace(t_ns=20_000_000 * k, of=found.__getitem__)
        cycle = Cycle(inputs, None)
        if k == len(samples) - 1:
            cycle.stops = dict(stops)
        check.on_samples(cycle)
        events += cycle.events
    return events, cycle


def steady(n=100):
    return [fan(30000.0 + RNG.normal(0, 200), 40.0 + RNG.normal(0, 0.2), 22.8) for _ in range(n)]


@pytest.mark.parametrize(
    "wrong", [{"speed_rpm": 7.0}, {"speed_rpm": -2e6}, {"fet_c": 155.0}, {"input_v": 3.0}]
)
def test_spikes_are_damaged_messages_and_the_wire_is_named(wrong):
    samples = steady()
    for k in (20, 40, 60):
        samples[k] = fan(**wrong)
    (event,), _ = told(samples)
    assert (event.source, event.level) == ("adhesion", "warning")
    assert "wire" in event.message
    samples[-1] = fan(**wrong)
    _, cycle = told(samples, {"adhesion": "falling"})
    assert list(cycle.stops) == ["adhesion", "damaged_reports"], "what presses harder depends on the first"
    assert cycle.suspects == {"adhesion"}


def test_what_happens_to_a_fan_is_no_damaged_message():
    runs_down = [fan(30000.0 * 0.95**k, 40.0, 22.8) for k in range(60)]
    steps = [*steady(50), *(fan(22000.0) for _ in range(50))]
    sags = [*steady(50), fan(input_v=15.0)]
    for samples in (steady(), runs_down, steps, sags):
        events, cycle = told(samples, {"battery_low": "15 V"})
        assert (events, list(cycle.stops)) == ([], ["battery_low"])
    _, cycle = told(steady())
    assert not cycle.stops, "it stops nothing by itself"


@pytest.mark.parametrize(
    ("seed", "share", "overrides"),
    [
        (8011, 0.1, {}),
        (8420, 0.5, {}),
        (8411, 0.3, {"load_cells": None}),
        (8412, 0.3, {"emulation.plant": "mujoco"}),
    ],
)
def test_a_wire_that_damages_the_fans_reports_stops_nothing_and_is_named(seed, share, overrides):
    named = []
    fault = f"adhesion:corrupt@1.5,probability={share}"
    keys = {"exit.look_after_s": 1.0, "loop.rate_hz": 50.0, **overrides}
    with hil.open_bench("emulated", seed=seed, overrides=keys, faults=[fault]) as bench:
        bench.drive(
            line((0, 0, 0), (0.2, 0, 0), duration_s=4.0),
            feedback="ekf",
            on_cycle=lambda record: named.extend(e.message for e in record.events if e.source == "adhesion"),
        )
    assert any("wire" in message for message in named)
    assert bench.held.state == "HELD"
