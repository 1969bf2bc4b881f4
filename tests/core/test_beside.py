"""A process beside ends with the one that began it, however that ends."""

import os
import signal
import subprocess
import sys
import time

import pytest

from hil.vocabulary.beside import beside

OTHER = """
import time
from hil.vocabulary.beside import end_with_parent

end_with_parent()
{then}
"""
ONE = """
import signal, time
from hil.vocabulary.beside import beside

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
with beside("other") as process:
    print(process.pid, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def other(tmp_path, monkeypatch):
    """Writes the module that runs beside."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    return lambda then: (tmp_path / "other.py").write_text(OTHER.format(then=then))


def gone(pid, within_s=10.0):
    """Whether a process ends in time; one that nobody waits for counts as ended."""
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        try:
            with open(f"/proc/{pid}/stat") as stat:
                if stat.read().rpartition(")")[2].split()[0] == "Z":
                    return True
        except FileNotFoundError:
            return True
        time.sleep(0.02)
    os.kill(pid, signal.SIGKILL)
    return False


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_nothing_is_left_when_a_signal_ends_the_one_that_began_it(other, number):
    other("time.sleep(60)")
    with subprocess.Popen(
        [sys.executable, "-c", ONE], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as one:
        pid = int(one.stdout.readline())
        one.send_signal(number)
        one.wait(10)
    assert gone(pid)


def test_it_is_waited_for_and_what_it_says_can_be_read(other):
    other("time.sleep(0.1); print('done'); raise SystemExit(3)")
    with beside("other", output=subprocess.PIPE) as process:
        said = process.stdout.read()
    assert (said, process.returncode) == (b"done\n", 3)


def test_an_error_ends_it_at_once(other):
    other("time.sleep(60)")
    begun_s = time.monotonic()
    with pytest.raises(ValueError, match="here"), beside("other") as process:
        raise ValueError("here")
    assert process.returncode == -signal.SIGKILL
    assert time.monotonic() - begun_s < 10
