"""A moving plant and the shortest serial line there is, so that the chip and the driver meet directly."""

import sys
import types
from collections import deque
from types import SimpleNamespace

import pytest
import serial
from turning_plant import TurningPlant

from hil.config.imu import Bno055Config
from hil.drivers.imu.bno055.driver import Bno055Imu
from hil.fakes.imu.bno055.chip import Bno055Chip
from hil.fakes.imu.bno055.faults import SUPPORTED_FAULTS
from hil.fakes.imu.bno055.sensor_physics import ImuTruthOptions
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.messages import STREAM_FAULTS, Messages, declared
from hil.faults.plan import FaultPlan

_LINES = {}


class DirectPort:
    """A pyserial-like port whose bytes reach one chip at the pace of the wire."""

    def __init__(self, port, baudrate=9600, timeout=None, write_timeout=None):
        self.port, self.baudrate, self.timeout = port, baudrate, timeout

    def open(self):
        name = self.port.split("//")[1]
        if name == "denied":
            raise serial.SerialException(13, "Permission denied")
        if name not in _LINES:
            raise serial.SerialException(2, "No such file or directory")
        self.name, (self.world, _, self.written) = name, _LINES[name]
        self._messages = Messages(
            self.world.faults,
            ("imu",),
            self.world.rng("line.imu"),
            STREAM_FAULTS.keys() - SUPPORTED_FAULTS.keys(),
        )
        self._coming = deque()
        self._free_ns = 0

    def close(self):
        if self.name not in _LINES:
            raise serial.SerialException(5, "Input/output error")

    def reset_input_buffer(self):
        while self._coming and self._coming[0][0] <= self.world.now_ns:
            self._coming.popleft()

    @property
    def in_waiting(self):
        return sum(arrived_ns <= self.world.now_ns for arrived_ns, _ in self._coming)

    def write(self, data):
        if self.name not in _LINES:
            raise serial.SerialException(5, "Input/output error")
        self.written.append(bytes(data))
        self.world.advance_to(self.world.now_ns + self._wire_ns(len(data)))
        self.world.sync_plant()
        for reply in _LINES[self.name][1].receive(bytes(data), self.world.now_ns, self.baudrate):
            for message in self._messages.received(reply.data, self.world.now_ns):
                self.push(reply.ready_ns, message)
        return len(data)

    def push(self, ready_ns, data):
        self._free_ns = max(self._free_ns, ready_ns)
        for byte in data:
            self._free_ns += self._wire_ns(1)
            self._coming.append((self._free_ns, byte))

    def read(self, size=1):
        deadline_ns = self.world.now_ns + round(self.timeout * 1e9)
        if len(self._coming) >= size and self._coming[size - 1][0] <= deadline_ns:
            self.world.advance_to(self._coming[size - 1][0])
        else:
            self.world.advance_to(deadline_ns)
        out = bytearray()
        while self._coming and len(out) < size and self._coming[0][0] <= self.world.now_ns:
            out.append(self._coming.popleft()[1])
        return bytes(out)

    def _wire_ns(self, count):
        return round(count * 10e9 / self.baudrate)


_package = types.ModuleType("imu_wire")
_module = types.ModuleType("imu_wire.protocol_chip")
_module.Serial = DirectPort
sys.modules.update({"imu_wire": _package, "imu_wire.protocol_chip": _module})
serial.protocol_handler_packages.append("imu_wire")


@pytest.fixture
def imu_bench():
    """Factory of a chip, its world and a driver on it."""

    def build(*faults, plant=None, config=None, options=None, seed=1, **chip_options):
        plan = FaultPlan([parse_fault(spec) for spec in faults])
        plant = plant if plant is not None else TurningPlant()
        world = World(plant, seed=seed, faults=plan)
        config = Bno055Config(**{"port": "chip://imu", "backend": "emulated", **(config or {})})
        chip = Bno055Chip(
            world,
            options=options or ImuTruthOptions(),
            mount_rotation_wxyz=config.mount_rotation_wxyz,
            bench_remap=(config.axis_map, config.axis_sign),
            **chip_options,
        )
        plan.declare("imu", declared(SUPPORTED_FAULTS, {}, STREAM_FAULTS))
        plan.check()
        written = []
        _LINES["imu"] = (world, chip, written)
        clock = VirtualClock(world)
        driver = Bno055Imu(config, clock)

        def interpose(chip):
            _LINES["imu"] = (world, chip, written)

        def unplug():
            _LINES.pop("imu")

        def plug():
            _LINES["imu"] = (world, chip, written)

        return SimpleNamespace(
            unplug=unplug,
            plug=plug,
            interpose=interpose,
            plant=plant,
            world=world,
            chip=chip,
            clock=clock,
            driver=driver,
            config=config,
            written=written,
        )

    yield build
    _LINES.clear()


@pytest.fixture
def turning_plant():
    return TurningPlant
