"""The image for the STM32F103, executed instruction by instruction with its registers played by this test."""

import itertools
import shutil
import struct
import subprocess

import cantools
import pytest
from node_on_host import FIRMWARE

from hil.config.encoders import SHIPPED_DBC
from hil.fakes.encoders.as5045.encoder import with_parity

DATABASE = cantools.database.load_file(SHIPPED_DBC)
FLASH, RAM, PERIPHERALS = 0x08000000, 0x20000000, 0x40000000
RCC_CR, RCC_CFGR, RCC_CSR = 0x21000, 0x21004, 0x21024
GPIOA_IDR, GPIOB_IDR, GPIOB_BSRR = 0x10808, 0x10C08, 0x10C10
TIM2_CNT, IWDG_KR = 0x24, 0x3000
CAN_MCR, CAN_MSR, CAN_TSR, CAN_ESR, CAN_BTR = 0x6400, 0x6404, 0x6408, 0x6418, 0x641C
POLL_US = 20
WORDS = [with_parity(k << 6 | 0x20) for k in (11, 1022, 2033, 4044)]


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    if not shutil.which("arm-none-eabi-gcc"):
        pytest.skip("no compiler for the STM32: install gcc-arm-none-eabi")
    folder = tmp_path_factory.mktemp("stm32")
    subprocess.run(["make", "-C", FIRMWARE, f"OUT={folder}", "stm32f103"], check=True, capture_output=True)
    return (folder / "stm32f103.bin").read_bytes()


class Microcontroller:
    """Just the registers that the node uses (ST RM0008), and four AS5045 on its pins."""

    def __init__(self, image, *, jumpers=0b11):
        unicorn = pytest.importorskip("unicorn", reason="to execute the image: pip install unicorn")
        mode = unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS
        self._cpu = cpu = unicorn.Uc(unicorn.UC_ARCH_ARM, mode)
        cpu.mem_map(FLASH, 64 * 1024)
        cpu.mem_map(RAM, 20 * 1024)
        cpu.mem_write(FLASH, image)
        cpu.mmio_map(PERIPHERALS, 0x30000, self._read, None, self._write, None)
        stack, self._at = struct.unpack_from("<II", image)
        cpu.reg_write(unicorn.arm_const.UC_ARM_REG_SP, stack)
        self._pc = unicorn.arm_const.UC_ARM_REG_PC
        self._registers = {RCC_CSR: 1 << 27}
        self._outputs, self._jumpers, self._left = 3 << 12, jumpers, 18
        self._pending, self._time_us = {}, 0
        self.acknowledged, self.sent, self.fed = True, [], 0

    def run(self, instructions):
        self._cpu.emu_start(self._at | 1, 0, count=instructions)
        self._at = self._cpu.reg_read(self._pc)

    def _read(self, _, address, size, __):
        value = self._registers.get(address, 0)
        if address == RCC_CR:
            return value | (value & (1 << 16 | 1 << 24)) << 1
        if address == RCC_CFGR:
            return value | (value & 3) << 2
        if address == GPIOA_IDR:
            return sum((word >> self._left & 1) << i for i, word in enumerate(WORDS))
        if address == GPIOB_IDR:
            return self._jumpers
        if address == TIM2_CNT:
            self._time_us += POLL_US
            return self._time_us & 0xFFFF
        if address == CAN_MSR:
            return self._registers.get(CAN_MCR, 0) & 1
        if address == CAN_TSR:
            return sum(1 << 26 + box for box in range(3) if box not in self._pending)
        return value

    def _write(self, _, address, size, value, __):
        self._registers[address] = value
        if address == GPIOB_BSRR:
            self._pins((self._outputs | value & 0xFFFF) & ~(value >> 16))
        elif address == IWDG_KR:
            self.fed += value == 0xAAAA
        elif address == CAN_TSR:
            for box in range(3):
                if value >> 7 + 8 * box & 1:
                    self._pending.pop(box, None)
        elif 0x6580 <= address < 0x65B0 and address % 16 == 0 and value & 1:
            low, high = self._registers[address + 8], self._registers[address + 12]
            assert self._registers[address + 4] == 8
            frame = (value >> 21, struct.pack("<II", low, high))
            if self.acknowledged:
                self.sent.append(frame)
            else:
                self._pending[(address - 0x6580) // 16] = frame

    def _pins(self, outputs):
        selected, rises = not outputs >> 12 & 1, outputs & ~self._outputs & 1 << 13
        if self._outputs >> 12 & 1:
            self._left = 18
        elif selected and rises:
            self._left -= 1
        self._outputs = outputs


def test_the_image_samples_sends_and_feeds_the_watchdog(image):
    board = Microcontroller(image)
    board.run(3_000_000)
    assert [frame_id for frame_id, _ in board.sent[:5]] == [416, 417, 418, 416, 417]
    frames = [(i, DATABASE.decode_message(i, d, decode_choices=False, scaling=False)) for i, d in board.sent]
    assert len(frames) > 100
    for frame_id, signals in frames:
        if frame_id == 416:
            assert [signals["AngleFL"], signals["AngleBL"]] == WORDS[:2]
        elif frame_id == 417:
            assert [signals["AngleBR"], signals["AngleFR"]] == WORDS[2:]
    left = [signals for frame_id, signals in frames if frame_id == 416]
    assert [signals["Sequence"] for signals in left[:100]] == list(range(len(left[:100])))
    periods = {b["NodeTime"] - a["NodeTime"] for a, b in itertools.pairwise(left)}
    assert periods <= {498, 500, 502}
    assert board.fed >= len(left)


def test_the_bus_runs_at_500_kbit_and_recovers_by_itself(image):
    board = Microcontroller(image)
    board.run(200_000)
    timing, control = board._registers[CAN_BTR], board._registers[CAN_MCR]
    quanta = 1 + (timing >> 16 & 15) + 1 + (timing >> 20 & 7) + 1
    assert 36_000_000 / ((timing & 0x3FF) + 1) / quanta == 500_000
    assert control & 1 << 6
    assert not control & 3


def test_jumpers_give_the_address(image):
    board = Microcontroller(image, jumpers=0b01)
    board.run(400_000)
    assert {frame_id for frame_id, _ in board.sent} == {416 + 8, 417 + 8, 418 + 8}


def test_without_a_partner_on_the_bus_only_the_newest_set_waits(image):
    board = Microcontroller(image)
    board.acknowledged = False
    board.run(1_500_000)
    assert board.sent == []
    assert len(board._pending) <= 3
    fed = board.fed
    board.acknowledged = True
    board._pending.clear()
    board.run(300_000)
    assert board.sent[0][0] == 416
    assert DATABASE.decode_message(416, board.sent[0][1])["Sequence"] > 20
    assert board.fed > fed
