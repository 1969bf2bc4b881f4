"""The encoder node's firmware: pins, frames and time, against cantools, the emulated node and the driver."""

import ctypes
import itertools
import random

import cantools
import numpy as np
import pytest
from node_on_host import HostBoard

from hil.config.encoders import SHIPPED_DBC, EncodersConfig
from hil.core.signals import WHEELS, Status
from hil.drivers.encoders.as5045.driver import As5045Encoders
from hil.drivers.encoders.as5045.word import decode_word
from hil.fakes.can_channel import CanChannel
from hil.fakes.encoders.as5045.chip import EncoderNode
from hil.fakes.encoders.as5045.encoder import OCF, chip, with_parity
from hil.fakes.encoders.as5045.encoder import word as word_of
from hil.fakes.world import Scheduled, VirtualClock, World
from hil.faults.plan import FaultPlan

DATABASE = cantools.database.load_file(SHIPPED_DBC)
NAMES = EncodersConfig().signals


class Turning:
    """A plant of which only the steering axes matter: they turn at a steady rate."""

    def __init__(self, rate_rad_s=(0.2, -0.3, 0.4, -0.5)):
        self.t_ns, self.rate_rad_s = 0, np.array(rate_rad_s)

    def advance(self, t_ns):
        self.t_ns = t_ns

    def steering_rad(self):
        return (self.rate_rad_s * self.t_ns * 1e-9).tolist()


def decoded(frames):
    return [DATABASE.decode_message(i, data, decode_choices=False, scaling=False) for i, data in frames]


def test_words_come_off_the_pins_as_the_chips_hold_them(library):
    random.seed(1)
    board = HostBoard(library)
    for _ in range(200):
        board.chips.words = [with_parity(random.getrandbits(18)) for _ in range(4)]
        left, right = decoded(board.next_set()[:2])
        assert [{**left, **right}[name] for name in NAMES] == board.chips.words


def test_a_set_has_one_moment(library):
    """The chips hold their angle at the first falling edge: what turns during the reading is not seen."""
    board = HostBoard(library)
    board.chips.words = [with_parity(k << 6) for k in (1, 2, 3, 4)]
    before = list(board.chips.words)
    data = board.chips.data

    def turning(t_ns):
        board.chips.words = [word ^ 0x3FFFF for word in board.chips.words]
        return data(t_ns)

    board.chips.data = turning
    left, right = decoded(board.next_set()[:2])
    assert [{**left, **right}[name] for name in NAMES] == before


def test_frames_are_the_bytes_that_cantools_makes(library):
    board = HostBoard(library, address=8, cause=1)
    board.chips.words = [with_parity(k << 6) for k in (100, 2000, 3000, 4095)]
    frames = board.next_set()
    assert [frame_id for frame_id, _ in frames] == [416 + 8, 417 + 8, 418 + 8]
    time_10us = decoded([(416, frames[0][1])])[0]["NodeTime"]
    values = dict(zip(NAMES, board.chips.words, strict=True)) | {"Sequence": 0, "NodeTime": time_10us}
    for frame_id, data in frames[:2]:
        message = DATABASE.get_message_by_frame_id(frame_id - 8)
        mine = {signal.name: values[signal.name] for signal in message.signals}
        assert data == message.encode(mine, scaling=False)
    status = {"Layout": 1, "Firmware": 1, "Rate": 200, "ResetCause": 1, "ParityErrors": 0, "LateSets": 0}
    expected = DATABASE.encode_message(418, {**status, "UnsentFrames": 0, "TimesOffBus": 0}, scaling=False)
    assert frames[2][1] == expected


def test_the_emulated_node_sends_the_same_bytes(library):
    world = World(Turning(), seed=3, faults=FaultPlan([]))
    channel = CanChannel(world)
    queue = channel.listen()
    EncoderNode(world, channel)
    VirtualClock(world).sleep_until_ns(2_000_000_000)
    reported = [(frame.arbitration_id, frame.data) for _, frame in queue]
    status = HostBoard(library).next_set()[2]
    assert [frame for frame in reported if frame[0] == 418] == [status] * 2
    pairs = [reported[i : i + 2] for i, frame in enumerate(reported) if frame[0] == 416]
    assert len(pairs) == 400
    for pair in pairs:
        values = {name: value for signals in decoded(pair) for name, value in signals.items()}
        words = (ctypes.c_uint32 * 4)(*(values[name] for name in NAMES))
        left, right = ctypes.create_string_buffer(8), ctypes.create_string_buffer(8)
        library.frames_of_set(words, values["Sequence"], values["NodeTime"], left, right)
        assert [(416, left.raw), (417, right.raw)] == pair


class NodeOnTheWire(Scheduled):
    """The compiled node in an emulated world: real chips' words on its pins, its frames on the bus."""

    def __init__(self, world, channel, library, **options):
        self._world, self._channel, self.silent = world, channel, False
        self._chips = [chip() for _ in WHEELS]
        self.board = HostBoard(library, **options)
        self._start_ns = self.board.t_ns
        world.add(self)

    def next_due_ns(self):
        start_us = self._start_ns // 1000
        return ((self.board.node.due_us - start_us) & 0xFFFFFFFF) * 1000

    def on_due(self, t_ns):
        board, angles = self.board, self._world.plant.steering_rad()
        board.t_ns = self._start_ns + t_ns
        board.chips.words = [word_of(c, 0, a, 0.0, OCF) for c, a in zip(self._chips, angles, strict=True)]
        assert board.poll()
        for frame_id, data in board.sent:
            if not self.silent:
                self._channel.transmit(frame_id, data, t_ns)
        del board.sent[:]


@pytest.fixture
def driven(library):
    """Angles and times that the driver reads from the compiled node, for some seconds."""
    opened = []

    def run(seconds, start_us=0):
        world = World(Turning(), seed=1, faults=FaultPlan([]))
        channel = CanChannel(world, "firmware").open()
        opened.append(channel)
        node = NodeOnTheWire(world, channel, library, start_us=start_us)
        clock = VirtualClock(world)
        driver = As5045Encoders(EncodersConfig(interface="hil", channel="firmware"), clock)
        opened.append(driver)
        driver.open()
        samples = []
        while clock.now_ns() < seconds * 1e9:
            clock.sleep_until_ns(clock.now_ns() + 10_000_000)
            samples += driver.read()
        return node, driver, samples

    yield run
    for thing in reversed(opened):
        thing.close()


@pytest.mark.parametrize("start_us", [0, (1 << 32) - 3_000_000])
def test_the_driver_reads_the_compiled_node(driven, start_us):
    """Past the wrap of the node's time after 10.5 s, and of the board's own clock."""
    _, driver, samples = driven(12.0, start_us)
    assert len(samples) > 12 * 199
    assert all(sample.status == (Status.OK,) * 4 for sample in samples)
    assert {b.stamp.seq - a.stamp.seq for a, b in itertools.pairwise(samples)} == {1}
    rate = Turning().rate_rad_s
    for sample in samples[200:]:
        turned = sample.angle_rad - rate * sample.stamp.t_ns * 1e-9
        error = np.remainder(turned + np.pi, 2 * np.pi) - np.pi
        assert np.max(np.abs(error)) < 2 * np.pi / 4096
    assert str(driver.node_status) == "firmware 1, started by power"
    assert (driver.node_status.rate_hz, driver.node_status.other_layout, driver.node_status.counted) == (
        200.0,
        "",
        "",
    )
    assert driver.passed_over == 0


def test_a_chip_that_is_not_there_is_a_fault_and_not_an_angle(library):
    """A line that is pulled up reads as ones, one that is shorted to ground as zeros."""
    board = HostBoard(library)
    for word, status in ((0x3FFFF, Status.HARDWARE_ERROR), (0, Status.STARTING)):
        board.chips.words = [word] * 4
        left, _ = decoded(board.next_set()[:2])
        assert decode_word(left["AngleFL"])[1] is status


def test_the_first_word_after_power_on_is_not_sent(library):
    board = HostBoard(library)
    assert (board.chips.readings, board.sent) == (1, [])
    board.next_set()
    assert board.chips.readings == 2


def test_wrong_parity_is_sent_as_it_is_and_counted(library):
    board = HostBoard(library)
    board.chips.words = [with_parity(5 << 6) ^ 1, 0, 0, 0]
    left, _ = decoded(board.next_set()[:2])
    assert left["AngleFL"] == board.chips.words[0]
    board.pass_until(1_100_000)
    last = [data for frame_id, data in board.sent if frame_id == 418][-1]
    assert decoded([(418, last)])[0]["ParityErrors"] == 201  # of 201 sets


def test_a_bus_without_partner_gets_the_newest_set_when_it_is_back(library):
    """Frames that wait are dropped for newer ones; the missing sets show in the sequence."""
    board = HostBoard(library)
    board.next_set()
    board.room = 2
    board.pass_until(500_000)
    assert board.waiting == 2
    unsent = board.node.status.unsent_frames
    assert unsent >= 2 * 95
    board.room = 3
    left = decoded(board.next_set()[:1])[0]
    assert left["Sequence"] == board.node.sets - 1
    assert board.node.status.unsent_frames == unsent + 2


def test_a_late_loop_skips_sets_instead_of_hurrying_after_them(library):
    board = HostBoard(library)
    board.next_set()
    board.t_ns += 42_000_000
    assert board.poll()
    assert not board.poll()
    assert (board.node.status.late_sets, board.node.sets) == (1, 2)


def test_the_watchdog_is_fed_by_sets_only(library):
    board = HostBoard(library)
    for _ in range(100):
        assert not board.poll()
    assert board.fed == 0
    board.next_set()
    assert board.fed == 1


def test_the_grid_keeps_its_rate(library):
    board = HostBoard(library, rate_hz=250)
    board.pass_until(2_000_000)
    assert board.node.sets == pytest.approx(500, abs=1)
