"""A fault that is planned for one device is no business of the others, nor of itself before it begins."""

import numpy as np

import hil
from hil.core.signals import ServoSetpoint
from hil.fakes.active_faults import FaultPlan
from hil.fakes.fault import Fault
from tests.to_the_bit import bits

CYCLES, RATE_HZ = 25, 100
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


def reported(*faults):
    """What all devices say in a while, and what the robot does."""
    seen = []
    with hil.open_bench("emulated", seed=5, faults=faults) as bench:
        actuators, deadline_ns = bench.rig.actuators(), bench.clock.now_ns()
        actuators.enable()
        for k in range(CYCLES):
            bench.clock.sleep_until_ns(deadline_ns)
            seen.append(bits(bench.rig.read(k)))
            actuators.command(ServoSetpoint(np.full(4, 0.02 * k), np.full(4, 0.002 * k)))
            seen.append(bits(bench.truth()))
            deadline_ns += 1_000_000_000 // RATE_HZ
    return seen


def test_until_a_fault_begins_everything_is_as_without_it():
    assert reported(*(f"{fault}@1000" for fault in LATER)) == reported()


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
