"""Each remedy of a finding that `hil doctor` prints is reached by a test, and names commands that exist.

Commands of `hil` in remedies are held against the command line in tests/docs/test_shown_commands.py.
"""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    "hil/bench/doctor.py",
    "hil/bench/force_findings.py",
    "hil/bench/promises.py",
    "hil/bench/host",
    "hil/devices",
    "hil/drivers",
)
PROVOKED_BY = (
    "tests/bench/test_doctor_host.py",
    "tests/bench/test_doctor_discover_setup.py",
    "tests/bench/test_doctor_slow_adapter.py",
    "tests/bench/test_looks.py",
    "tests/bench/test_bench_wheel_model.py",
    "tests/devices/test_packages_at_fault.py",
    "tests/encoders/test_node_status.py",
    "tests/adhesion_bench/test_fan_driver.py",
    "tests/adhesion_dronecan/test_dronecan_fan.py",
    "tests/adhesion_bench/test_propellers_on_vescs.py",
    "tests/servos/test_servo_driver_open.py",
    "tests/servos/test_servo_models.py",
    "tests/imu_microstrain/test_microstrain_on_a_bench.py",
    "tests/tracker_mavlink/test_mavlink_doctor.py",
    "tests/tracker_mavlink/test_mavlink_time.py",
    "tests/tracker/test_tracker_faults.py",
)
"""Tests that make a doctor's findings go wrong, one by one."""
PROGRAMS = {  # with the Debian package that has each
    "apt": "apt",
    "fuser": "psmisc",
    "hil": "this one",
    "ip": "iproute2",
    "ss": "iproute2",
    "systemctl": "systemd",
    "tee": "coreutils",
    "udevadm": "udev",
    "usermod": "passwd",
}


def sites():
    """(file, first line, last line, remedy as in the source) of every finding that can carry a remedy."""
    for room in ROOMS:
        path = ROOT / room
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding":
                    given = [k.value for k in node.keywords if k.arg == "remedy"] + node.args[5:6]
                    if given and not (isinstance(given[0], ast.Constant) and not given[0].value):
                        yield str(file), node.lineno, node.end_lineno, ast.unparse(given[0])


def in_backticks():
    """First words of commands in backticks in strings of the rooms that remedies come from."""
    for room in ROOMS:
        path = ROOT / room
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            tree = ast.parse(file.read_text(encoding="utf-8"))
            described = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}  # docstrings
            for node in ast.walk(tree):
                if isinstance(getattr(node, "value", None), str) and id(node) not in described:
                    yield from re.findall(r"(?:`|`?sudo )([a-z_0-9]+) [^`]", node.value)


def test_every_program_that_a_remedy_names_is_known_by_its_package():
    assert set(in_backticks()) == set(PROGRAMS)


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_every_finding_with_a_remedy_is_reached_by_a_test(tmp_path):
    told = tmp_path / "reached.json"
    paths = os.pathsep.join([str(ROOT), str(Path(__file__).parent)])
    environment = os.environ | {"REMEDIES_REACHED": str(told), "PYTHONPATH": paths}
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "remedies_reached",
            "-p",
            "no:cacheprovider",
            "-m",
            "",
            *PROVOKED_BY,
        ],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
    )
    reached = json.loads(told.read_text())
    unreached = {
        remedy
        for file, first, last, remedy in sites()
        if not any(path == file and first <= line <= last for path, line in reached)
    }
    assert unreached == set(), done.stdout[-2000:]
