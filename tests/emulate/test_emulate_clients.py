"""Clients that know nothing of this project talk to `hil emulate`: the scripts in `examples/`, tools."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, PacketHandler, PortHandler

pytestmark = pytest.mark.usefixtures("warm_commands")

EXAMPLES = Path(__file__).parents[2] / "examples"
CLIENT_S = 60.0


def run_example(name, endpoints_file):
    """A script in an interpreter that cannot import this project; what it printed."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("COV_CORE")}
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys, runpy; sys.modules['hil'] = None; sys.argv = sys.argv[1:]; "
            "runpy.run_path(sys.argv[0], run_name='__main__')",
            EXAMPLES / f"{name}.py",
            endpoints_file,
        ],
        capture_output=True,
        text=True,
        timeout=CLIENT_S,
        env=environment,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def number(pattern, text):
    found = re.search(pattern, text)
    assert found, text
    return float(found[1])


def test_stock_dynamixel_sdk(endpoints_file):
    said = run_example("dynamixel_bus", endpoints_file)
    assert re.findall(r"servo (\d): model 1010", said) == list("12345678")
    assert number(r"(\d+) sync reads", said) > 20
    turned, asked = number(r"turned (-?[\d.]+)", said), number(r"asked for ([\d.]+)", said)
    assert 0.8 * asked < turned < 1.6 * asked


def test_plain_pyserial_reads_the_inertial_unit(endpoints_file):
    said = run_example("bno055_uart", endpoints_file)
    assert "chip id 0xA0" in said
    assert number(r"(\d+) reads per second", said) > 30
    assert abs(number(r"length ([\d.]+)", said) - 1.0) < 1e-3
    assert abs(number(r"gravity ([\d.]+)", said) - 9.81) < 0.3


def test_python_can_and_cantools_decode_the_encoders(endpoints_file):
    said = run_example("encoders_can", endpoints_file)
    assert number(r"(\d+) frames per second", said) > 200
    assert re.findall(r"Angle(\w\w)", said) == ["BL", "BR", "FL", "FR"]


def test_the_public_natnet_client_finds_the_robot(endpoints_file):
    said = run_example("mocap_natnet", endpoints_file)
    assert number(r"(\d+) frames per second", said) > 40
    assert re.search(r"^robot: .* tracked$", said, re.M)


def test_a_fault_reaches_the_client(emulate):
    where = emulate("--only", "servos", "--fault", "servo.drive_BL:off")["servos"]
    port, packets = PortHandler(where["port"]), PacketHandler(2.0)
    assert port.openPort()
    assert port.setBaudRate(where["baud"])
    try:
        silent = where["ids"].pop(1)
        for i in where["ids"]:
            assert any(packets.ping(port, i)[1] == COMM_SUCCESS for _ in range(50)), f"servo {i} is silent"
        assert {packets.ping(port, silent)[1] for _ in range(5)} == {COMM_RX_TIMEOUT}
    finally:
        port.closePort()
