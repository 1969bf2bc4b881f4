"""Whatever bytes arrive, the servo driver ends in bounded time with samples or with an error of ours."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_wire import JointPlant

from hil.config.servos import ServosConfig
from hil.core.errors import DeviceError, HilError
from hil.core.signals import Status
from hil.drivers.servos.dynamixel.commissioning import scan, set_up
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.drivers.servos.dynamixel.packets import GroupRead, find_statuses
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.serial_line import SerialLine
from hil.fakes.servos.dynamixel import protocol
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.world import VirtualClock, World
from tests.selected import draws

SECOND = 1_000_000_000
STATUSES = st.builds(protocol.status, st.integers(0, 253), st.integers(0, 255), st.binary(max_size=20))
PIECES = st.lists(st.binary(max_size=60) | STATUSES, min_size=1, max_size=8)


class Babbler(SerialChip):
    """Answers every request with the next of some byte strings; in front of a real bus where given one."""

    def __init__(self, answers, bus=None):
        self.name, self.supported_faults = "servos", {}
        self.answers, self.bus, self.count, self.babbling = answers, bus, 0, bus is None

    def receive(self, data, t_ns, baud):
        honest = self.bus.receive(data, t_ns, baud) if self.bus is not None else []
        if not self.babbling:
            return honest
        noise = self.answers[self.count % len(self.answers)]
        self.count += 1
        late_ns = 10_000 * (self.count % 7) ** 3
        return sorted([*honest, Reply(t_ns + late_ns, noise)], key=lambda r: r.ready_ns)

    def reset(self, t_ns):
        self.count = 0


@contextlib.contextmanager
def babbling(answers, *, with_bus=False, **config):
    """(chip, driver, clock) on a line whose far end babbles."""
    world = World(JointPlant(), seed=1)
    chip = Babbler(answers, ServoBus(world) if with_bus else None)
    line = SerialLine(world, chip).open()
    clock = VirtualClock(world)
    driver = DynamixelServos(ServosConfig(port="hil://servos", backend="emulated", **config), clock)
    try:
        yield chip, driver, clock
    finally:
        driver.close()
        line.close()


@draws(25)
@given(answers=PIECES)
def test_opening_a_bus_that_talks_nonsense_is_a_device_error(answers):
    with babbling(answers) as (_, driver, clock):
        with pytest.raises(DeviceError):
            driver.open()
        assert clock.now_ns() < 5 * SECOND


@draws(15)
@given(answers=PIECES, fast=st.sampled_from(["auto", False]))
def test_nonsense_between_the_answers_gives_samples_or_a_device_error(answers, fast):
    with babbling(answers, with_bus=True, fast_sync_read=fast) as (chip, driver, clock):
        driver.open()
        driver.enable()
        chip.babbling = True
        for _ in range(12):
            began = clock.now_ns()
            with contextlib.suppress(DeviceError):
                (sample,) = driver.read()
                good = np.array([s is Status.OK for s in sample.status])
                assert np.isfinite(sample.position_rad[good]).all()
                assert np.isnan(sample.position_rad[~good]).all()
                driver.read_health()
            assert clock.now_ns() - began < 60_000_000
            clock.sleep_until_ns(began + 100_000_000)
        driver.stop()
        with contextlib.suppress(DeviceError):
            driver.release()
        with contextlib.suppress(DeviceError):
            driver.enable()


@draws(30)
@given(answers=PIECES, registers=st.just({}) | st.just({"return_delay_time": 0}))
def test_scan_and_set_up_survive_nonsense(answers, registers):
    with babbling(answers) as (_, _driver, clock):
        found = scan("hil://servos", clock, bauds=(1_000_000, 57_600), ids=range(10))
        assert all(0 <= s.servo_id < 10 for s in found)
        with contextlib.suppress(HilError):
            set_up("hil://servos", clock, baud=1_000_000, servo_id=1, new_id=2, registers=registers)
        assert clock.now_ns() < 20 * SECOND


@draws(200)
@given(data=st.binary(max_size=300), fast=st.booleans())
def test_the_parsers_take_any_bytes(data, fast):
    group = GroupRead(range(1, 9), 126, 10, fast=fast)
    for answer in group.answers(data).values():
        assert (answer.status is Status.OK) == (len(answer.data) == 10)
    group.complete(data)
    assert all(0 <= servo_id <= 255 for servo_id, _ in find_statuses(data))


@draws(200)
@given(
    values=st.lists(st.integers(-(2**31), 2**31 - 1), min_size=8, max_size=8),
    damage=st.lists(st.tuples(st.integers(0, 150), st.integers(1, 255)), max_size=3),
    fast=st.booleans(),
    noise=st.binary(max_size=5),
)
def test_a_damaged_answer_never_yields_another_number(values, damage, fast, noise):
    ids = range(1, 9)
    data = [v.to_bytes(4, "little", signed=True) for v in values]
    if fast:
        reply = b"".join(protocol.fast_status([(i, 0, d) for i, d in zip(ids, data, strict=True)], 1 + 8 * 8))
    else:
        reply = b"".join(protocol.status(i, 0, d) for i, d in zip(ids, data, strict=True))
    spoilt = bytearray(noise + reply)
    for place, bits in damage:
        if place < len(spoilt):
            spoilt[place] ^= bits
    answers = GroupRead(ids, 132, 4, fast=fast).answers(bytes(spoilt))
    for i, d in zip(ids, data, strict=True):
        assert answers[i].status is not Status.OK or answers[i].data == d
    if not damage and not noise:
        assert all(a.status is Status.OK for a in answers.values())
