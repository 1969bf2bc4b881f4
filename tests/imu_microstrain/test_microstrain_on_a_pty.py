"""Driver, plain pyserial script and emulated sensor across a real pseudo-terminal, in real time."""

import threading

import pytest
import serial

from hil.config.microstrain import MicrostrainConfig
from hil.core.clock import MonotonicClock
from hil.core.signals import Status
from hil.drivers.imu.microstrain.driver import MicrostrainImu
from hil.fakes.imu.microstrain.chip import MicrostrainChip
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.world import World
from hil.links.mip import fields as f
from hil.links.mip.packets import Field, PacketParser, encode

pytestmark = pytest.mark.alone


@pytest.fixture
def served(turning_plant):
    world = World(turning_plant(rate_rad_s=0.2), seed=1)
    transport = SerialPty(SerialLine(world, MicrostrainChip(world)))
    server = EmulationServer(world, MonotonicClock(), {"imu": transport})
    thread = threading.Thread(target=server.run)
    thread.start()
    yield transport.endpoint()["port"]
    server.stop()
    thread.join(10)


def test_the_driver_reads_the_stream(served):
    clock = MonotonicClock()
    driver = MicrostrainImu(MicrostrainConfig(port=served, reply_timeout_s=0.5), clock)
    driver.open()
    assert driver.identity()["model"] == "3DM-CV7-AHRS"
    samples, t_ns = [], clock.now_ns()
    for _ in range(80):
        samples += driver.read()
        t_ns += 10_000_000
        clock.sleep_until_ns(t_ns)
    driver.close()
    good = [s for s in samples if s.status is Status.OK]
    assert len(good) > 50
    assert good[-1].gyro_rad_s[2] == pytest.approx(-0.2, abs=0.03)


def test_a_plain_pyserial_script_talks_to_the_sensor(served):
    """Ping, who are you, filter data at 10 Hz, as the vendor's examples do it."""
    with serial.Serial(served, 115_200, timeout=2.0) as port:
        port.write(bytes.fromhex("756501020201E0C6"))
        assert port.read(10).hex() == "7565010404f10100d56a"
        port.write(encode(f.BASE, [Field(f.DEVICE_INFO)]))
        (reply,) = PacketParser(1).feed(port.read(6 + 4 + 84), 0)
        assert f.DeviceInfo.from_bytes(reply.fields[1].data).number == "6286"
        layout = bytes((f.WRITE,)) + f.format_data(f.FILTER_DATA, ((f.GRAVITY, 100),))
        port.write(encode(f.THREE_DM, [Field(f.MESSAGE_FORMAT, layout)]))
        assert port.read(10)[6:8] == bytes((f.MESSAGE_FORMAT, f.DONE))
        (packet,) = PacketParser(1).feed(port.read(22), 0)
        x, y, z, valid = f.LAYOUTS[f.GRAVITY].unpack(packet.fields[0].data)
        assert x * x + y * y + z * z == pytest.approx(9.78**2, rel=1e-3)
        assert valid == 1
