"""A fault that is planned for one device is no business of the others, nor of itself before it begins.

Nor does it matter whether parts of the world say when they are due, or are asked before every step.
"""

import numpy as np

import hil
from hil.core.errors import HilError
from hil.core.signals import ServoSetpoint
from hil.fakes.world import World
from hil.faults.fault import Fault
from hil.faults.plan import FaultPlan
from tests.to_the_bit import bits

LATER = (
    "servos:stuck",
    "servo.drive_FL:off",
    "servo.steer_BR:slow",
    "servos:drop",
    "imu:garbage",
    "tracker:stuck",
    "mocap:drop",
    "encoders:corrupt",
    "encoder.BL:wrong",
    "adhesion:wrong",
    "thrust:slow",
    "load_cells:jump",
    "plant:adhesion_loss",
)
NOW = ("imu:reset@0.6", "imu:slow@1", "tracker:unplug@0.7+0.2", "mocap:off@0.6+0.3", "adhesion:off@0.8+0.1")


def reported(bench_name, cycles, rate_hz, faults=()):
    """What all devices say in a while, what the robot does, and how the world's clock stood."""
    seen = []
    with hil.open_bench(bench_name, seed=5, faults=faults) as bench:
        actuators, deadline_ns = bench.devices.actuators(), bench.clock.now_ns()
        actuators.enable()
        for k in range(cycles):
            bench.clock.sleep_until_ns(deadline_ns)
            try:
                seen.append(bits(bench.devices.read(k)))
                actuators.command(ServoSetpoint(np.full(4, 0.02 * k), np.full(4, 0.002 * k)))
            except HilError as error:
                seen.append(str(error))
            seen += [bits(bench.truth()), str(bench.clock.now_ns())]
            deadline_ns += 1_000_000_000 // rate_hz
        actuators.close()
    return seen


def test_until_a_fault_begins_everything_is_as_without_it():
    assert reported("emulated", 25, 100, [f"{fault}@1000" for fault in LATER]) == reported(
        "emulated", 25, 100
    )


def test_telling_and_being_asked_are_the_same(monkeypatch):
    telling = reported("emulated_delivered", 40, 50, NOW)
    add = World.add

    def add_to_be_asked(self, part):
        part.announces = False
        add(self, part)

    monkeypatch.setattr(World, "add", add_to_be_asked)
    assert reported("emulated_delivered", 40, 50, NOW) == telling


def test_what_is_planned_for_a_device_concerns_it_by_all_of_its_names():
    plan = FaultPlan([Fault("servo.3", "off")])
    bus, camera = plan.of("servos", "servo.3"), plan.of("tracker")
    assert not bus.empty
    assert camera.empty
    plan.declare("tracker", {"stuck": ()})
    plan.add(Fault("tracker", "stuck"))
    assert not camera.empty
    plan.clear()
    assert plan.empty
    assert not camera.empty  # it goes on asking: nothing else reports that it is well again
    assert plan.of("tracker").empty
