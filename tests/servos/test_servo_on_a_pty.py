"""The stock SDK and our driver on an emulated bus behind a pseudo-terminal, in real time."""

import struct
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import serial
from dynamixel_sdk import (
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    PacketHandler,
    PortHandler,
)
from servo_wire import JointPlant

from hil.config.servos import ServosConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import ServoSetpoint, Status
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.world import World

pytestmark = pytest.mark.alone

IDS = range(1, 9)


@pytest.fixture
def served_bus():
    """Factory of a bus on a terminal, served by a thread."""
    running = []

    def serve(latency_s=0.001, **options):
        world = World(JointPlant(), seed=1)
        bus = ServoBus(world, options=ServoBusOptions(**options))
        transport = SerialPty(SerialLine(world, bus, latency_s=latency_s), {"baud": bus.options.baud})
        server = EmulationServer(world, MonotonicClock(), {"servos": transport})
        thread = threading.Thread(target=server.run)
        thread.start()
        running.append((server, thread))
        return SimpleNamespace(bus=bus, transport=transport, port=transport.endpoint()["port"])

    yield serve
    for server, thread in running:
        server.stop()
        thread.join(5)


class Patient:
    """The SDK with its calls repeated, after a silence, when this machine was too busy to answer in time."""

    def __init__(self, sdk, port):
        self.sdk, self.port = sdk, port

    def __getattr__(self, name):
        call = getattr(self.sdk, name)
        if not callable(call):
            return call

        def repeated(*arguments):
            for _ in range(10):
                answer = call(*arguments)
                found = answer if isinstance(answer, tuple) else (answer,)
                if not {COMM_RX_TIMEOUT, COMM_RX_CORRUPT} & {f for f in found if isinstance(f, int)}:
                    break
                self.port.ser.timeout = 0.2
                self.port.ser.read(1000)
                self.port.ser.timeout = 0
            return answer

        return repeated


@pytest.fixture
def sdk(served_bus):
    """Stock port and packet handler at 1 Mbit/s, and the bus."""
    served = served_bus()
    port = PortHandler(served.port)
    handler = Patient(PacketHandler(2.0), port)
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    yield port, handler, served.bus
    port.closePort()


def test_the_stock_sdk_pings_reads_and_writes(sdk):
    port, handler, bus = sdk
    assert handler.ping(port, 3) == (1010, COMM_SUCCESS, 0)
    assert PacketHandler(2.0).ping(port, 77)[1] == COMM_RX_TIMEOUT
    assert handler.read1ByteTxRx(port, 5, 7) == (5, COMM_SUCCESS, 0)
    assert handler.read2ByteTxRx(port, 5, 0) == (1010, COMM_SUCCESS, 0)
    assert handler.write4ByteTxRx(port, 5, 116, 2100) == (COMM_SUCCESS, 0)
    assert handler.read4ByteTxRx(port, 5, 116) == (2100, COMM_SUCCESS, 0)
    assert handler.write1ByteTxRx(port, 5, 122, 1) == (COMM_SUCCESS, 7)
    assert handler.regWriteTxRx(port, 5, 65, 1, [1]) == (COMM_SUCCESS, 0)
    assert handler.action(port, 5) == COMM_SUCCESS
    time_limit = time.monotonic() + 2.0
    while handler.read1ByteTxRx(port, 5, 65)[0] != 1:
        assert time.monotonic() < time_limit
    assert handler.clearMultiTurn(port, 1) == (COMM_SUCCESS, 0)
    assert handler.factoryReset(port, 2, 0x02) == (COMM_SUCCESS, 0)
    assert handler.reboot(port, 4) == (COMM_SUCCESS, 0)
    assert {s.joint for s in bus.servos if s.booted_ns > 0} == {1, 3}


def test_the_stock_sdk_scans_by_broadcast(sdk):
    port, handler, _ = sdk
    found, result = handler.broadcastPing(port)
    assert result == COMM_SUCCESS
    assert found == {i: [1010, 46] for i in IDS}


@pytest.mark.parametrize("fast", [False, True])
def test_the_stock_sdk_reads_and_writes_groups(sdk, fast):
    port, handler, bus = sdk
    write = GroupSyncWrite(port, handler.sdk, 116, 4)
    for i in IDS:
        assert write.addParam(i, list(struct.pack("<i", 1000 + i)))
    assert write.txPacket() == COMM_SUCCESS
    read = Patient(GroupSyncRead(port, handler.sdk, 116, 4), port)
    for i in IDS:
        assert read.addParam(i)
    assert (read.fastSyncRead() if fast else read.txRxPacket()) == COMM_SUCCESS
    assert [read.getData(i, 116, 4) for i in IDS] == [1000 + i for i in IDS]
    bulk_write = GroupBulkWrite(port, handler.sdk)
    bulk_write.addParam(1, 65, 1, [1])
    bulk_write.addParam(2, 116, 4, list(struct.pack("<i", 77)))
    assert bulk_write.txPacket() == COMM_SUCCESS
    bulk = Patient(GroupBulkRead(port, handler.sdk), port)
    bulk.addParam(1, 65, 1)
    bulk.addParam(2, 116, 4)
    bulk.addParam(8, 144, 2)
    assert (bulk.fastBulkRead() if fast else bulk.txRxPacket()) == COMM_SUCCESS
    assert [bulk.getData(*key) for key in ((1, 65, 1), (2, 116, 4), (8, 144, 2))] == [1, 77, 111]
    assert bus.servos[0].table.get("led") == 1


@pytest.mark.parametrize("baud", [57_600, 4_000_000])
def test_other_rates_and_the_wrong_one(served_bus, baud):
    served = served_bus(baud=baud)
    port, handler = PortHandler(served.port), PacketHandler(2.0)
    port.openPort()
    try:
        port.setBaudRate(1_000_000)
        assert handler.ping(port, 1)[1] == COMM_RX_TIMEOUT
        port.setBaudRate(baud)
        assert Patient(handler, port).ping(port, 1) == (1010, COMM_SUCCESS, 0)
    finally:
        port.closePort()


def drive(driver, clock, setpoint, cycles):
    samples, t_ns = [], clock.now_ns()
    for _ in range(cycles):
        samples += driver.read()
        driver.command(setpoint)
        t_ns += 10_000_000
        clock.sleep_until_ns(t_ns)
    return samples


@pytest.mark.parametrize("baud", [1_000_000, 4_500_000])
def test_the_driver_drives_across_the_terminal(served_bus, baud):
    """In ten tries: wheels stop, and start anew, where this computer pauses longer than the bus watchdog."""
    served, clock = served_bus(baud=baud), MonotonicClock()
    driver = DynamixelServos(ServosConfig(port=served.port, baud=baud, reply_slack_s=0.05), clock)
    driver.open()
    try:
        driver.enable()
        setpoint = ServoSetpoint(np.array([1.0, -1.0, 2.0, 0.0]), np.array([0.3, -0.3, 0.0, 0.1]))
        for _ in range(10):
            good = [s for s in drive(driver, clock, setpoint, 60) if s.ok]
            assert len(good) > 40
            if np.allclose(good[-1].velocity_rad_s[:4], setpoint.drive_velocity_rad_s, atol=0.05):
                break
        np.testing.assert_allclose(good[-1].velocity_rad_s[:4], setpoint.drive_velocity_rad_s, atol=0.05)
        np.testing.assert_allclose(good[-1].position_rad[4:], setpoint.steer_position_rad, atol=0.02)
        driver.release()
    finally:
        driver.close()


def test_a_busy_terminal_is_reported(served_bus):
    served, clock = served_bus(), MonotonicClock()
    driver = DynamixelServos(ServosConfig(port=served.port), clock)
    with (
        serial.Serial(served.port, 1_000_000, exclusive=True),
        pytest.raises(DeviceError, match="close the other program"),
    ):
        driver.open()


def test_an_emulator_that_dies_is_silence_then_an_error(served_bus):
    served, clock = served_bus(), MonotonicClock()
    driver = DynamixelServos(ServosConfig(port=served.port, fail_after_s=0.2, reply_slack_s=0.05), clock)
    driver.open()
    try:
        served.transport.close()
        assert set(driver.read()[0].status) == {Status.TIMEOUT}
        with pytest.raises(DeviceTimeoutError, match="nothing usable"):
            drive(driver, clock, ServoSetpoint(np.zeros(4), np.zeros(4)), 500)
    finally:
        driver.close()
