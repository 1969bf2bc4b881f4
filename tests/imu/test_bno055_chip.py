"""The emulated BNO055 on its wire: golden exchanges, error codes, modes, pages, units, timing."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.fakes.imu.bno055.sensor_physics import ImuTruthOptions
from hil.fakes.imu.bno055.uart import RequestParser
from hil.fakes.world import NEVER_NS

MS = 1_000_000
BAUD = 115_200


class Client:
    """The shortest possible UART client: bytes in, bytes out, at chosen times."""

    def __init__(self, bench):
        self.bench, self.chip, self.world = bench, bench.chip, bench.world

    def send(self, text, baud=BAUD):
        self.world.sync_plant()
        replies = self.chip.receive(bytes.fromhex(text), self.world.now_ns, baud)
        return b"".join(r.data for r in replies).hex(" ").upper()

    def after(self, milliseconds):
        self.world.advance_to(self.world.now_ns + round(milliseconds * MS))
        return self

    def read(self, register, length):
        reply = bytes.fromhex(self.send(f"AA 01 {register:02X} {length:02X}"))
        assert reply[:2] == bytes((0xBB, length))
        return reply[2:]


@pytest.fixture
def client(imu_bench):
    return Client(imu_bench(overrun_probability=0.0))


GOLDEN_FILE = Path(__file__).parents[1] / "golden" / "bno055_uart.json"
GOLDEN = [(e["request"], e["reply"]) for e in json.loads(GOLDEN_FILE.read_text())["exchanges"]]


@pytest.mark.parametrize(("request_hex", "reply_hex"), GOLDEN)
def test_golden_exchanges(client, request_hex, reply_hex):
    assert client.send(request_hex) == reply_hex


def test_a_request_may_come_in_pieces(client):
    assert [client.after(1).send(byte) for byte in ("AA", "01", "00", "01")] == ["", "", "", "BB 01 A0"]


def test_an_unfinished_request_times_out(client):
    assert client.chip.next_poll_ns() == NEVER_NS
    assert client.send("AA 01 00") == ""
    assert client.chip.poll(client.world.now_ns) == []
    client.after(30)
    assert client.chip.next_poll_ns() == client.world.now_ns
    assert client.chip.poll(client.world.now_ns)[0].data.hex() == "ee0a"
    assert client.send("AA 01 00 01") == "BB 01 A0"
    client.send("AA 01")
    assert client.after(40).send("AA 01 00 01") == "EE 0A BB 01 A0"


def test_only_config_mode_takes_configuration(client):
    assert client.send("AA 00 3D 01 08") == "EE 01"
    assert client.send("AA 00 3D 01 00") == "EE 03"
    client.after(8)
    assert client.send("AA 00 3B 01 00") == "EE 05"
    assert client.send("AA 00 55 01 00") == "EE 05"
    assert client.send("AA 00 07 01 01") == "EE 01"
    assert client.send("AA 00 08 01 0D") == "EE 05"
    assert client.send("AA 00 0F 01 04") == "EE 01"
    assert client.send("AA 00 07 01 00") == "EE 01"
    assert client.send("AA 00 3D 01 00") == "EE 01"
    assert client.after(18).send("AA 00 3B 01 02") == "EE 03"
    assert client.after(1).send("AA 00 3B 01 02") == "EE 01"


def test_page_one_has_its_own_registers(client):
    client.send("AA 00 07 01 01")
    assert client.send("AA 01 07 04") == "BB 04 01 0D 6D 38"
    assert client.send("AA 00 08 01 0F") == "EE 01"
    assert client.read(0x08, 1) == b"\x0f"
    assert client.send("AA 00 50 01 00") == "EE 05"
    assert client.read(0x50, 16) != bytes(16)
    client.send("AA 00 07 01 00")
    assert client.read(0x00, 1) == b"\xa0"


def test_status_and_data_follow_the_mode(client):
    assert client.read(0x39, 1) == b"\x00"
    client.send("AA 00 3D 01 08")
    assert client.after(6).read(0x39, 1) == b"\x00"
    assert client.after(1).read(0x39, 1) == b"\x05"
    assert client.read(0x20, 8) == bytes(8)
    assert client.after(15).read(0x20, 8) != bytes(8)
    client.send("AA 00 3D 01 07")
    assert client.after(30).read(0x39, 1) == b"\x06"
    assert client.read(0x1A, 26) == bytes(26)
    assert client.send("AA 00 3D 01 07") == "EE 01"
    client.send("AA 00 3D 01 00")
    assert client.after(30).read(0x08, 45) == bytes(45)


@pytest.mark.parametrize(
    ("mode", "acc", "mag", "gyr", "fused"),
    [
        (1, 1, 0, 0, 0),
        (2, 0, 1, 0, 0),
        (3, 0, 0, 1, 0),
        (4, 1, 1, 0, 0),
        (5, 1, 0, 1, 0),
        (6, 0, 1, 1, 0),
        (7, 1, 1, 1, 0),
        (8, 1, 0, 1, 1),
        (9, 1, 1, 0, 1),
        (10, 1, 1, 0, 1),
        (11, 1, 1, 1, 1),
        (12, 1, 1, 1, 1),
    ],
)
def test_each_mode_switches_its_sensors_on(client, mode, acc, mag, gyr, fused):
    client.bench.plant.rate_rad_s = 0.3
    client.send(f"AA 00 3D 01 {mode:02X}")
    block = client.after(200).read(0x08, 44)
    parts = [any(block[a : a + 6]) for a in (0, 6, 12)] + [any(block[24:32])]
    assert parts == [bool(x) for x in (acc, mag, gyr, fused)]


def test_units_change_the_counts(imu_bench):
    quiet = ImuTruthOptions(
        accelerometer_noise_m_s2=0, accelerometer_offset_m_s2=0, gyro_noise_rad_s=0, gyro_bias_rad_s=0
    )
    found = {}
    for units in (0x00, 0x17, 0x80):
        bench = imu_bench(options=quiet, overrun_probability=0.0)
        bench.plant.rate_rad_s = 0.5
        client = Client(bench)
        client.send(f"AA 00 3B 01 {units:02X}")
        client.send("AA 00 3D 01 08")
        found[units] = struct.unpack("<22hbB", client.after(100).read(0x08, 46))
    metric, other, android = found.values()
    assert metric[0] == pytest.approx(980, abs=6)
    assert other[0] == pytest.approx(1000, abs=6)
    assert metric[8] == pytest.approx(np.degrees(0.5) * 16, abs=1)
    assert other[8] == pytest.approx(450, abs=1)
    assert (metric[22], other[22]) == (27, 40)
    assert other[9] == pytest.approx(metric[9] * 900 * np.pi / 180 / 16, abs=30)
    assert android[11] == -metric[11]


@pytest.mark.parametrize("acknowledge", [True, False])
def test_reset_is_650_ms_of_silence_and_forgets_everything(imu_bench, acknowledge):
    client = Client(imu_bench(overrun_probability=0.0, acknowledge_reset=acknowledge))
    client.send("AA 00 41 01 21")
    client.send("AA 00 3D 01 08")
    client.after(50)
    assert client.send("AA 00 3F 01 20") == ("EE 01" if acknowledge else "")
    assert client.after(649).send("AA 01 00 01") == ""
    assert client.after(1).send("AA 01 00 01") == "BB 01 A0"
    assert client.read(0x3D, 1) == b"\x00"
    assert client.read(0x41, 1) == b"\x24"


def test_other_triggers(client):
    assert client.send("AA 00 3F 01 81") == "EE 01"
    assert client.read(0x3F, 1) == b"\x80"
    assert client.read(0x36, 1) == b"\x0f"
    assert client.send("AA 00 3F 01 40") == "EE 01"
    assert client.read(0x37, 1) == b"\x00"


def test_suspend_stops_the_output(client):
    client.send("AA 00 3E 01 02")
    client.send("AA 00 3D 01 08")
    assert client.after(100).read(0x20, 8) == bytes(8)
    client.send("AA 00 3D 01 00")
    assert client.after(30).send("AA 00 3E 01 00") == "EE 01"
    assert client.read(0x3D, 1) == b"\x00"


@pytest.mark.parametrize("baud", [9600, 57600, 230400])
def test_a_wrong_baud_rate_is_silence(client, baud):
    assert client.send("AA 01 00 01", baud=baud) == ""
    assert client.send("AA 01 00 01") == "BB 01 A0"


@pytest.mark.parametrize("axis_map", ["25", "00", "3F", "27"])
def test_an_impossible_axis_map_leaves_the_register_and_the_axes_as_they_were(client, axis_map):
    """Datasheet 3.4: "previous configuration will be restored in the register map"."""
    client.send(f"AA 00 41 02 {axis_map} 00")
    assert client.read(0x41, 2) == b"\x24\x00"
    client.send("AA 00 3D 01 08")
    x, y, z = struct.unpack("<3h", client.after(100).read(0x2E, 6))
    assert abs(x) > 950
    assert abs(y) + abs(z) < 60
    client.send("AA 00 3D 01 08")
    x, y, z = struct.unpack("<3h", client.after(100).read(0x2E, 6))
    assert abs(x) > 950
    assert abs(y) + abs(z) < 60


def test_offsets_are_learnt_restored_and_applied_with_the_last_byte(client):
    true = client.chip.sensors.true_offsets.gyroscope
    counts = [round(v * 16 * 180 / np.pi) for v in true]
    data = struct.pack("<3h", *counts)
    client.send("AA 00 61 05 " + data[:5].hex())
    assert client.chip.sensors.calibration.gyroscope == [0.0] * 3
    client.send("AA 00 66 01 " + data[5:].hex())
    np.testing.assert_allclose(client.chip.sensors.calibration.gyroscope, true, atol=0.001)
    assert client.read(0x61, 6) == data
    client.send("AA 00 3D 01 08")
    client.after(2000).send("AA 00 3D 01 00")
    learnt = struct.unpack("<3h", client.after(30).read(0x61, 6))
    np.testing.assert_allclose(learnt, counts, atol=1)


def test_bus_overrun_comes_at_its_rate_and_less_without_magnetometer(imu_bench):
    share = {}
    for mode in ("0C", "08", "00"):
        client = Client(imu_bench(overrun_probability=0.1))
        client.send(f"AA 00 3D 01 {mode}")
        client.after(100)
        share[mode] = sum(client.send("AA 01 20 08") == "EE 07" for _ in range(2000)) / 2000
    assert share["0C"] == pytest.approx(0.1, abs=0.03)
    assert share["08"] == pytest.approx(0.02, abs=0.01)
    assert share["00"] == 0.0


@given(st.lists(st.binary(max_size=40), max_size=30))
def test_no_bytes_whatever_upset_the_parser(chunks):
    parser = RequestParser()
    for k, chunk in enumerate(chunks):
        for request in parser.feed(chunk, k):
            assert request.error in (0, 6, 8, 9)
            assert request.error or 1 <= request.length <= 128
    parser.reset()
    assert parser.feed(bytes.fromhex("AA010001"), 99)[0].length == 1


def test_random_requests_never_upset_the_chip(client):
    rng = np.random.default_rng(0)
    for _ in range(3000):
        body = rng.integers(0, 256, rng.integers(0, 12)).astype(np.uint8).tobytes()
        head = bytes((0xAA, int(rng.integers(0, 2)))) if rng.random() < 0.8 else b""
        client.send((head + body).hex())
        client.after(float(rng.exponential(5)))
