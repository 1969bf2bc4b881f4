"""An emulated MicroStrain sensor on its line, a plant that turns, and the driver on it, in virtual time."""

from types import SimpleNamespace

import pytest
from turning_plant import TurningPlant

from hil.config.microstrain import MicrostrainConfig
from hil.drivers.imu.microstrain.driver import MicrostrainImu
from hil.fakes.imu.microstrain.chip import MicrostrainChip
from hil.fakes.imu.microstrain.sensing import MicrostrainTruthOptions
from hil.fakes.serial_line import SerialLine
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan

IDEAL = MicrostrainTruthOptions(
    gyro_noise_rad_s=0,
    gyro_bias_rad_s=0,
    accelerometer_noise_m_s2=0,
    accelerometer_offset_m_s2=0,
    heading_drift_rad_s=0,
    filter_gravity_m_s2=9.80665,
)


@pytest.fixture
def turning_plant():
    return TurningPlant


@pytest.fixture
def ideal():
    """A sensor without errors."""
    return IDEAL


@pytest.fixture
def bench():
    """Factory of a world with a chip on a line, and a driver on it."""
    lines = []

    def build(*faults, plant=None, config=None, options=None, seed=1, latency_s=0.001, **chip_options):
        plan = FaultPlan([parse_fault(spec) for spec in faults])
        plant = plant if plant is not None else TurningPlant()
        world = World(plant, seed=seed, faults=plan)
        config = MicrostrainConfig(**{"port": "hil://imu", "backend": "emulated", **(config or {})})
        chip = MicrostrainChip(
            world, options=options, mount_rotation_wxyz=config.mount_rotation_wxyz, **chip_options
        )
        for line in lines:
            line.close()
        line = SerialLine(world, chip, latency_s=latency_s).open()
        lines.append(line)
        plan.check()
        clock = VirtualClock(world)
        driver = MicrostrainImu(config, clock)

        def run(duration_s, period_ns=10_000_000):
            """Read in cycles; the samples."""
            samples, end_ns = [], clock.now_ns() + round(duration_s * 1e9)
            while clock.now_ns() < end_ns:
                due_ns = clock.now_ns() + period_ns
                samples += driver.read()
                clock.sleep_until_ns(due_ns)
            return samples

        return SimpleNamespace(
            plant=plant, world=world, chip=chip, line=line, clock=clock, driver=driver, config=config, run=run
        )

    yield build
    for line in lines:
        line.close()
