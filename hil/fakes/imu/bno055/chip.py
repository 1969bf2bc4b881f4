"""The emulated BNO055 at the end of a serial line: firmware states, registers, faults.

Timing: reset 650 ms of silence, CONFIG to any mode 7 ms, any mode to CONFIG 19 ms, fusion at 100 Hz of
its own clock (Bosch BNO055 datasheet rev 1.4). Register 0x3D and everything a client reads
depend only on the requests and the world's truth.
"""

from __future__ import annotations

import struct
from collections import deque

from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.imu.bno055 import registers as reg
from hil.fakes.imu.bno055 import uart as bno055_uart
from hil.fakes.imu.bno055.faults import SUPPORTED_FAULTS, ImuFaults
from hil.fakes.imu.bno055.register_encoding import EMPTY, LENGTH, encode, load_offsets, store_offsets
from hil.fakes.imu.bno055.sensor_physics import (
    ImuTruthOptions,
    InertialSensors,
    matrix,
    names_each_axis,
    product,
    remap,
)
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.world import NEVER_NS, Scheduled, World

__all__ = ["SUPPORTED_FAULTS", "Bno055Chip"]

RESET_NS = 650_000_000
TO_RUNNING_NS, TO_CONFIG_NS = 7_000_000, 19_000_000
_ANSWER_NS = 100_000
_CELSIUS = 27.0
_HISTORY = 256
_BAUD_TOLERANCE = 0.03
_PUT = struct.Struct(f"{LENGTH}s").pack_into
_HEADS = tuple(bytes((0xBB, length)) for length in range(reg.SIZE + 1))
"""Header of the answer to a read, by its length."""


class Bno055Chip(SerialChip, Scheduled):
    """BNO055 chip with registers, self-calibration and faults.

    Args:
        world: truth, seed and faults; the chip registers itself there.
        name: device name of its faults.
        options: true imperfections.
        mount_rotation_wxyz: sensor axes in the body **after** the remap `bench_remap`, so that the mount is
            correct for a bench that configures this remap, unless the options differ.
        bench_remap: (axis map, axis sign) that the bench configures.
        overrun_probability: chance that a read is answered with bus overrun; a fifth of it without the
            magnetometer, whose 20 Hz processing causes it.
        acknowledge_reset: True if a reset command is acknowledged before the silence (real chips do either).
    """

    Options = ImuTruthOptions
    alone = True
    announces = True
    polls_alone = True

    def __init__(
        self,
        world: World,
        *,
        name: str = "imu",
        options: ImuTruthOptions | None = None,
        mount_rotation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
        bench_remap: tuple[int, int] = (0x24, 0x00),
        overrun_probability: float = 0.01,
        acknowledge_reset: bool = True,
    ) -> None:
        self.name, self.supported_faults = name, SUPPORTED_FAULTS
        self._world = world
        rng = world.rng(name)
        self._rng = rng
        options = options if options is not None else ImuTruthOptions()
        mount = options.mount_rotation_wxyz or mount_rotation_wxyz
        chip_in_body = product(matrix(mount), remap(*bench_remap))
        self.sensors = InertialSensors(options, rng, chip_in_body=chip_in_body)
        self._overrun = overrun_probability
        self._acknowledge_reset = acknowledge_reset
        self._stretch = 1.0 + 1e-6 * options.clock_ppm
        self._serial = int(rng.integers(1, 1 << 60))
        self._parser = bno055_uart.RequestParser()
        self._faults = ImuFaults(world.faults, name, rng)
        world.faults.declare(name, SUPPORTED_FAULTS)
        self._history: deque[tuple[int, bytes]] = deque(maxlen=_HISTORY)
        self._boot(0)
        self._boot_end_ns = self._switched_ns = 0
        world.add(self)

    @classmethod
    def build(cls, request: EmulationRequest) -> Bno055Chip:
        """Make the chip from its table of the bench file."""
        config = request.config
        return cls(
            request.world,
            name=request.kind,
            options=request.options(cls.Options, position_m=config.mount_position_m),
            mount_rotation_wxyz=config.mount_rotation_wxyz,
            bench_remap=(config.axis_map, config.axis_sign),
        )

    @property
    def opr_mode(self) -> int:
        """Operating mode that the client has set."""
        return self._pages[0][reg.OPR_MODE] & 0x0F

    def next_due_ns(self) -> int:
        """Time of the next fusion output."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Measure, and write one set of outputs to the data registers."""
        mode, sensors = self._mode, self.sensors
        faults = None if self._faults.plan.empty else self._faults
        period_ns = round(
            1e9 / mode.rate_hz * self._stretch * (faults.period_factor(t_ns) if faults else 1.0)
        )
        self._due_ns = t_ns + period_ns
        if faults is not None:
            if self._power(t_ns):
                return
            sensors.turn(faults.jump_rad(t_ns))
        sensed = sensors.sense(self._world.plant.body(), mode, period_ns * 1e-9)
        if faults is not None:
            sensed = faults.distort(sensed, t_ns)
        block = encode(sensed, mode, self._pages[0][reg.UNIT_SEL], self._calibration_byte(mode), _CELSIUS)
        self._history.append((t_ns, block))
        shown = block if faults is None else self._faults.shown(block, self._history, t_ns)
        _PUT(self._pages[0], reg.DATA, shown)

    def reset(self, t_ns: int) -> None:
        """Power was cycled: the chip boots in silence and then is in CONFIG mode."""
        self._boot(t_ns)

    def receive(self, data: bytes, t_ns: int, baud: int) -> list[Reply]:
        """Answer requests; no answer at a wrong baud rate, while booting or without power."""
        if self._power(t_ns) or t_ns < self._boot_end_ns:
            self._parser.reset()
            return []
        if abs(baud - bno055_uart.BAUD) > _BAUD_TOLERANCE * bno055_uart.BAUD:
            self._parser.reset()
            return []
        replies = self.poll(t_ns)
        faults = None if self._faults.plan.empty else self._faults
        ready_ns = t_ns + _ANSWER_NS + (0 if faults is None else faults.delay_ns(t_ns))
        for request in self._parser.feed(data, t_ns):
            answer = self._answer(request, t_ns)
            if faults is not None:
                answer = faults.spoil(answer, t_ns)
            if answer:
                replies.append(Reply(ready_ns, answer))
        return replies

    def poll(self, t_ns: int) -> list[Reply]:
        """Report a character timeout of an incomplete request."""
        if self._parser.expire(t_ns):
            return [Reply(t_ns, bno055_uart.status(bno055_uart.CHARACTER_TIMEOUT))]
        return []

    def next_poll_ns(self) -> int:
        """Time of the next character timeout, `NEVER_NS` without an incomplete request."""
        expires_ns = self._parser.expires_ns()
        return NEVER_NS if expires_ns is None else expires_ns

    def _boot(self, t_ns: int) -> None:
        self._pages = (reg.page_zero(), reg.page_one(self._serial))
        self._page = 0
        self._mode = reg.MODES[reg.CONFIG]
        self._boot_end_ns = t_ns + RESET_NS
        self._switched_ns = self._boot_end_ns
        self._due_ns = NEVER_NS
        self._parser.reset()
        self._history.clear()
        self.sensors.calibration.clear()
        self.sensors.set_remap(0x24, 0x00)
        self.sensors.restart_fusion()
        self._world.changed(self)

    def _power(self, t_ns: int) -> bool:
        """Apply power faults; True while the chip has no power or is booting."""
        if self._faults.plan.empty:
            return False
        boot_ns = self._faults.boot_at_ns(t_ns)
        if boot_ns is not None:
            self._boot(boot_ns)
        return self._faults.dead or t_ns < self._boot_end_ns

    def _answer(self, request: bno055_uart.Request, t_ns: int) -> bytes:
        if request.error:
            return bno055_uart.status(request.error)
        if request.data is not None:
            return self._write(request.register, request.data, t_ns)
        if request.register + request.length > reg.SIZE:
            return bno055_uart.status(bno055_uart.INVALID_ADDRESS)
        if self._overrun > 0.0 and self._rng.random() < self._overrun_now():
            return bno055_uart.status(bno055_uart.BUS_OVERRUN)
        return _HEADS[request.length] + self._read(request.register, request.length, t_ns)

    def _overrun_now(self) -> float:
        if not self._mode.fusion:
            return 0.0
        return self._overrun if self._mode.magnetometer else 0.2 * self._overrun

    def _read(self, register: int, length: int, t_ns: int) -> bytearray:
        page = self._pages[self._page]
        page[reg.PAGE_ID] = self._page
        if self._page == 0:
            running = self._mode is not reg.MODES[reg.CONFIG] and t_ns >= self._switched_ns
            state = reg.STATUS_FUSION if self._mode.fusion else reg.STATUS_NO_FUSION
            page[reg.SYS_STATUS] = state if running else reg.STATUS_IDLE
        return page[register : register + length]

    def _write(self, register: int, data: bytes, t_ns: int) -> bytes:
        end = register + len(data)
        if end > reg.SIZE:
            return bno055_uart.status(bno055_uart.INVALID_ADDRESS)
        allowed = reg.writable if self.opr_mode == reg.CONFIG else reg.writable_while_running
        if not all(allowed(self._page, a) for a in range(register, end)):
            return bno055_uart.status(bno055_uart.WRITE_DISABLED)
        if t_ns < self._switched_ns and register != reg.PAGE_ID:
            return bno055_uart.status(bno055_uart.WRITE_FAIL)
        code = bno055_uart.WRITE_SUCCESS
        for address, value in enumerate(data, register):
            code = self._store(address, value, t_ns)
            if code != bno055_uart.WRITE_SUCCESS:
                break
        return bno055_uart.status(code) if code else b""

    def _store(self, address: int, value: int, t_ns: int) -> int:
        """Write one register with its side effects; returns the status code, 0 for no answer."""
        if address == reg.PAGE_ID:
            if value > 1:
                return bno055_uart.WRITE_FAIL
            self._page = value
            return bno055_uart.WRITE_SUCCESS
        page = self._pages[self._page]
        if self._page == 1:
            page[address] = value
            return bno055_uart.WRITE_SUCCESS
        if address == reg.OPR_MODE:
            return self._switch(value & 0x0F, t_ns)
        if address == reg.SYS_TRIGGER:
            return self._trigger(value, t_ns)
        if address == reg.PWR_MODE and value & 0x03 == 0x03:
            return bno055_uart.WRITE_FAIL
        if address == reg.AXIS_MAP and not names_each_axis(value):
            return bno055_uart.WRITE_SUCCESS
        page[address] = value
        if address in (reg.AXIS_MAP, reg.AXIS_SIGN):
            self.sensors.set_remap(page[reg.AXIS_MAP], page[reg.AXIS_SIGN])
        load_offsets(page, address, self.sensors.calibration)
        return bno055_uart.WRITE_SUCCESS

    def _switch(self, mode: int, t_ns: int) -> int:
        if mode not in reg.MODES:
            return bno055_uart.WRITE_FAIL
        page = self._pages[0]
        if mode == self.opr_mode:
            return bno055_uart.WRITE_SUCCESS
        suspended = page[reg.PWR_MODE] & 0x03 == reg.POWER_SUSPEND
        page[reg.OPR_MODE] = mode
        self._mode = reg.MODES[mode]
        self._switched_ns = t_ns + (TO_CONFIG_NS if mode == reg.CONFIG else TO_RUNNING_NS)
        if mode == reg.CONFIG:
            page[reg.DATA : reg.DATA + LENGTH] = EMPTY
            store_offsets(page, self.sensors.calibration)
        else:
            page[reg.DATA : reg.DATA + LENGTH] = EMPTY
            self.sensors.restart_fusion()
        stopped = mode == reg.CONFIG or suspended
        self._due_ns = NEVER_NS if stopped else self._switched_ns + round(1e9 / self._mode.rate_hz)
        self._world.changed(self)
        return bno055_uart.WRITE_SUCCESS

    def _trigger(self, value: int, t_ns: int) -> int:
        if value & reg.TRIGGER_RESET:
            self._boot(t_ns)
            return bno055_uart.WRITE_SUCCESS if self._acknowledge_reset else 0
        if value & reg.TRIGGER_SELF_TEST:
            self._pages[0][reg.SELFTEST] = 0x0F
        if value & reg.TRIGGER_RESET_INT:
            self._pages[0][reg.INT_STA] = 0
        self._pages[0][reg.SYS_TRIGGER] = value & reg.TRIGGER_CRYSTAL
        return bno055_uart.WRITE_SUCCESS

    def _calibration_byte(self, mode: reg.Mode) -> int:
        if not mode.fusion:
            return 0
        accelerometer, gyroscope, magnetometer = self.sensors.calibration.levels()
        gyroscope = gyroscope if mode.gyroscope else 0
        magnetometer = magnetometer if mode.magnetometer else 0
        system = accelerometer
        if mode.gyroscope and gyroscope < system:
            system = gyroscope
        if mode.magnetometer and magnetometer < system:
            system = magnetometer
        return system << 6 | gyroscope << 4 | accelerometer << 2 | magnetometer
