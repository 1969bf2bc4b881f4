"""Driver and emulated sensor share what is on the wire, nothing else: so one shows the other's mistakes."""

import subprocess
import sys

import pytest

HERE = "hil.devices.imu.microstrain."


@pytest.mark.parametrize(
    ("module", "unknown"),
    [
        ("driver", [HERE + "chip", HERE + "commands", HERE + "sensing", HERE + "faulty", "hil.fakes"]),
        ("chip", [HERE + "driver", HERE + "dialogue", HERE + "link", HERE + "readings", "hil.drivers"]),
    ],
)
def test_neither_knows_the_other(module, unknown):
    script = f"import {HERE}{module}, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not set(unknown) & set(loaded.stdout.split())
