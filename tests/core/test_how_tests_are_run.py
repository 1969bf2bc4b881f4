"""Which tests run beside which, and the list of the slowest, are about tests that exist."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.lanes import ALONE, REAL_TIME, THINNED, WIRED
from tests.slowest import durations, table

TESTS = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("begin", [*REAL_TIME, *ALONE, *THINNED, *WIRED])
def test_every_entry_means_a_test_that_is_there(begin):
    path, _, name = begin.partition("::")
    assert (TESTS / path).exists()
    assert not name or re.search(rf"^def {name}", (TESTS / path).read_text(encoding="utf-8"), re.MULTILINE)


def test_the_slowest_of_all_processes_come_first(tmp_path):
    case = '<testcase classname="tests.a" name="test_{0}[x.y]" time="{0}"/>'
    for name, seconds in (("virtual", range(30)), ("alone", (40, 50))):
        cases = "".join(case.format(s) for s in seconds)
        (tmp_path / f"{name}.xml").write_text(f"<testsuites><testsuite>{cases}</testsuite></testsuites>")
    lines = table(durations(tmp_path))
    assert lines[0].split() == ["50.0", "s", "tests/a.py::test_50[x.y]"]
    assert [float(line.split()[0]) for line in lines[:20]] == [50, 40, *range(29, 11, -1)]
    assert lines[20].split() == ["525.0", "s", "all", "32"]


INHERITED = """
import signal, subprocess, sys
for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)
signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
{mended}
print(subprocess.check_output(["grep", "-E", "Sig(Blk|Ign)", "/proc/self/status"], text=True))
"""


OF_PROGRAMS = sum(1 << (number - 1) for number in signal.valid_signals())
"""Mask of the signals that a program may handle: two more are the C library's own."""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells what a process ignores")
def test_what_a_test_starts_neither_ignores_nor_blocks_a_signal():
    told = {}
    for mended in ("", "from tests.signals import as_a_program_begins; as_a_program_begins()"):
        done = subprocess.run(
            [sys.executable, "-c", INHERITED.format(mended=mended)],
            cwd=TESTS.parent,
            capture_output=True,
            text=True,
            check=True,
        )
        masks = [int(line.split()[1], 16) for line in done.stdout.split("\n") if line]
        told[bool(mended)] = [mask & OF_PROGRAMS for mask in masks]
    assert all(told[False])
    assert not any(told[True])


LANES = """
import sys
sys.path.insert(0, "tests")
import in_two_lanes
lane = "import os, sys, time; print(os.getpid(), flush=True); time.sleep(600)"
in_two_lanes.command = lambda folder, name, *options: [sys.executable, "-c", lane]
sys.exit(in_two_lanes.main())
"""


def ignore_hang_ups():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)


@pytest.mark.parametrize(
    ("numbers", "before"),
    [([signal.SIGINT], None), ([signal.SIGHUP], None), ([signal.SIGHUP, signal.SIGTERM], ignore_hang_ups)],
)
def test_what_ends_the_run_ends_its_lanes_and_a_closed_terminal_does_not_under_nohup(numbers, before):
    with subprocess.Popen(
        [sys.executable, "-c", LANES],
        cwd=TESTS.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    ) as run:
        lane = int(run.stdout.readline())
        for number in numbers:
            assert run.poll() is None
            os.kill(run.pid, number)
        run.communicate(timeout=60)
    assert run.returncode == 128 + numbers[-1]
    with pytest.raises(ProcessLookupError):
        os.kill(lane, 0)
