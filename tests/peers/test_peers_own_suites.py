"""The suites of python-can and pyserial, from their own source, on what stands here for their ports.

Twice each: in virtual time, and in real time on the ports that `hil emulate` serves. In virtual time a port
stands still while a test sleeps on the host's clock, and no call blocks. What cannot pass is listed here with
its reason; all else has to, and what is listed has to fail.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from source_distributions import source_of

HERE = Path(__file__).parent
SLEEPS = "waits for its bytes by time.sleep, in which no world time passes"
MODEM = "an emulated line has no modem signals: CTS and DSR are always on"
BLOCKS = "wants to interrupt a call that blocks; none does"
CAN_IN_VIRTUAL_TIME = {
    "test_timestamp": "sleeps 2 s on the host's clock between two frames",
    "test_timestamp_is_absolute": "stamps are on the world's clock, which has no time of day",
}
SERIAL_IN_VIRTUAL_TIME = {
    "test.Test0_DataWires.test1_RTS": MODEM,
    "test.Test0_DataWires.test2_DTR": MODEM,
    "test.Test1_Forever.test2_ReadEmpty": "a thread sends after 3 s of the host's clock; refused at once",
    "test.Test2_Forever.test2_Loopback": SLEEPS,
    "test.Test3_Timeout.test2_Loopback": SLEEPS,
    "test.Test4_Nonblocking.test2_Loopback": SLEEPS,
    "test.Test4_Nonblocking.test2_LoopbackTimeout": SLEEPS,
    "test.Test_MoreTimeouts.test_WriteTimeout": "no flow control by XON and XOFF: a write is never held up",
    "test_cancel.TestCancelRead.test_cancel_once": BLOCKS,
    "test_cancel.TestCancelWrite.test_cancel_once": BLOCKS,
}

CAN_AT_THE_WIRE = {"test_unique_message_instances": "python-can's udp_multicast has no receive_own_messages"}
NO_MODEM = "a pseudo-terminal has no modem lines"
SERIAL_AT_THE_WIRE = {
    "test.Test0_DataWires.test1_RTS": NO_MODEM,
    "test.Test0_DataWires.test2_DTR": NO_MODEM,
    "test.Test0_DataWires.test3_RI": NO_MODEM,
    "test_cancel.TestCancelWrite.test_cancel_once": "a pseudo-terminal takes at once what is written",
}

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    ("package", "script", "at_least", "cannot"),
    [
        ("python-can", ("run_python_can.py",), 16, CAN_IN_VIRTUAL_TIME),
        ("python-can", ("run_python_can.py", "multicast"), 16, CAN_AT_THE_WIRE),
        ("pyserial", ("run_pyserial.py",), 45, SERIAL_IN_VIRTUAL_TIME),
        ("pyserial", ("run_pyserial.py", "pty"), 45, SERIAL_AT_THE_WIRE),
    ],
    ids=[
        "python-can in virtual time",
        "python-can at the wire",
        "pyserial in virtual time",
        "pyserial at the wire",
    ],
)
def test_a_peers_own_suite_passes_but_for_what_is_listed(tmp_path, package, script, at_least, cannot):
    source = source_of(package, tmp_path)
    done = subprocess.run(
        [sys.executable, HERE / script[0], source, *script[1:]],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    reported = json.loads(done.stdout.splitlines()[-1])
    assert len(reported["run"]) >= at_least
    assert set(reported["bad"]) == set(cannot), reported["bad"]
