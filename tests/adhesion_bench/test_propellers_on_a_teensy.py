"""The emulated Teensy of the propellers at the wire: what it does with lines and without."""

from contextlib import closing

import numpy as np
import pytest

from hil.config.robot import RobotConfig
from hil.config.thrust import TeensyConfig
from hil.drivers.thrust.teensy.driver import TeensyThrust
from hil.fakes.plant import make_plant
from hil.fakes.serial_line import SerialLine
from hil.fakes.thrust.teensy.chip import TeensyChip
from hil.fakes.thrust.teensy.true_parameters import ThrustTruthOptions
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan

S = 1_000_000_000


def propellers(config, seed, *faults):
    plan = FaultPlan([parse_fault(spec) for spec in faults])
    plant = make_plant(
        RobotConfig(), rng=np.random.default_rng(0), randomise_truth=False, faults=plan, by_hand=True
    )
    world = World(plant, seed=seed, faults=plan)
    chip = TeensyChip(world, config, ThrustTruthOptions(start="off"))
    return chip, SerialLine(world, chip), VirtualClock(world)


@pytest.mark.parametrize("seed", range(3))
def test_lines_that_are_cut_nine_times_in_ten_cost_three_steps_of_throttle_at_most(seed):
    config = TeensyConfig(port="hil://thrust")
    chip, line, clock = propellers(config, seed, "thrust:truncate@1,probability=0.9")
    driver, least = TeensyThrust(config, clock), 180
    with closing(line.open()):
        driver.open()
        driver.set_duty(0.75)
        for k in range(100, 3_000):
            clock.sleep_until_ns(k * S // 100)
            driver.read()
            least = min(least, chip.step)
        driver.close()
    assert 132 <= least <= chip.step <= 135


@pytest.mark.parametrize("begun", [180, 20])
def test_after_an_invalid_line_the_throttle_goes_down_a_step_every_tenth_of_a_second(begun):
    config = TeensyConfig()
    chip, line, clock = propellers(config, 0)
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
