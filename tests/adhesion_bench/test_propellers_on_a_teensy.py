"""The emulated Teensy of the propellers at the wire: what it does with lines and without."""

import numpy as np
import pytest

from hil.config.robot import RobotConfig
from hil.config.thrust import TeensyConfig
from hil.fakes.plant import make_plant
from hil.fakes.serial_line import SerialLine
from hil.fakes.thrust.teensy.chip import TeensyChip
from hil.fakes.thrust.teensy.true_parameters import ThrustTruthOptions
from hil.fakes.world import VirtualClock, World
from hil.faults.plan import FaultPlan

S = 1_000_000_000


@pytest.mark.parametrize("begun", [180, 20])
def test_after_an_invalid_line_the_throttle_goes_down_a_step_every_tenth_of_a_second(begun):
    plan = FaultPlan([])
    plant = make_plant(
        RobotConfig(), rng=np.random.default_rng(0), randomise_truth=False, faults=plan, by_hand=True
    )
    world = World(plant, seed=0, faults=plan)
    config = TeensyConfig()
    chip = TeensyChip(world, config, ThrustTruthOptions(start="off"))
    line, clock = SerialLine(world, chip), VirtualClock(world)
    line.send(b"THR%d\n" % begun, config.baud)
    clock.sleep_until_ns(3 * S)
    assert chip.step == begun
    line.send(b"THR999\n", config.baud)
    for passed in range(begun + 5):
        clock.sleep_until_ns(3 * S + passed * S // 10 + S // 20)
        assert chip.step == max(begun - passed, 0)
    line.send(b"THR7\n", config.baud)
    clock.sleep_until_ns(clock.now_ns() + S)
    assert chip.step == 7
