"""README's test with a fault runs unchanged on four benches and leaves the same rows in the report."""

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hil.pytest_plugin import OF_A_BENCH
from tests.docs.test_docs import python_block
from tests.patience import patient_bench
from tests.served_as_real import served_as_real

pytestmark = [pytest.mark.long, pytest.mark.real_time, pytest.mark.timeout(1200)]

WHERE = ("bench", "emulated", "injected")
"""Rows that say on which bench a test ran: they are there on all, with other values."""


def rows(folder: Path, name: str, *options: str, at: str = "chip") -> list[tuple[str, str]]:
    """Run the tests of a folder in a process of their own; name, outcome and rows of its only test.

    Args:
        folder: folder of the tests.
        name: name of the report.
        options: options of pytest.
        at: place at which the report says that the fault was injected.
    """
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={name}.xml", *options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, f"{name}: {done.stdout}{done.stderr}"
    (case,) = ElementTree.parse(folder / f"{name}.xml").iter("testcase")
    found = [(one.get("name"), one.get("value")) for one in case.iter("property")]
    assert re.match(f"tracker:silent@3\\+1 at the {at}.*: 3.00 to 4.00 s", dict(found)["injected"])
    return [
        ("test", case.get("name")),
        ("outcome", *(one.tag for one in case if one.tag != "properties")),
        *((key, "" if key in WHERE else value) for key, value in found if key in OF_A_BENCH),
    ]


def test_readmes_test_with_a_fault_passes_on_four_benches_with_the_same_rows(tmp_path):
    (tmp_path / "test_bench.py").write_text(python_block("pytest.mark.fault"))
    emulated = patient_bench(tmp_path, "emulated")
    found = [
        rows(tmp_path, "virtual", f"--bench={emulated}"),
        rows(tmp_path, "realtime", f"--bench={emulated}", "--hil-realtime"),
    ]
    with served_as_real(tmp_path, profile=str(emulated), faulty=["tracker"]) as served:
        real = (f"--bench={served}", "--hil-inject-real")
        found += [rows(tmp_path, "mix", *real, "--emulate=encoders", at="link")]
        found += [rows(tmp_path, "real", *real, at="link")]
    assert found == [found[0]] * 4
    assert {("outcome",), ("fault", "tracker:silent@3+1"), ("held", "HELD")} <= set(found[0])
