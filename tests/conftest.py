"""For all tests: public recordings, property tests without limits of wall-clock time, who needs the clock."""

import errno
import gc
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from unittest import mock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy comes; as the command line does

import pytest
from hypothesis import HealthCheck, settings

from hil.recording import mcap_file
from tests import warm
from tests.lanes import ALONE, REAL_TIME, THINNED, WIRED, files
from tests.selected import DRAWS
from tests.signals import as_a_program_begins

PATIENT = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("hil", **PATIENT, max_examples=DRAWS, derandomize=True)  # no run is red by chance
settings.register_profile("thorough", **PATIENT, max_examples=10 * DRAWS)
settings.load_profile("hil")
gc.set_threshold(50_000, 20, 20)  # thousands of tests keep much alive in which there is no garbage
_IN_REAL_TIME = files("real_time", *REAL_TIME, *WIRED)
ROOT = Path(__file__).resolve().parents[1]


def pytest_configure(config):
    as_a_program_begins()
    config.addinivalue_line("markers", "real_time: waits for a clock; not beside tests that keep a core busy")
    config.addinivalue_line(
        "markers", "alone: judges the clock, or needs a port of the host; nothing beside it"
    )


def pytest_collection_modifyitems(items):
    seen = Counter()
    for item in items:
        item.add_marker(pytest.mark.opens_stand_ins)  # no test of this project names hardware
        path = item.path.as_posix().removeprefix(f"{ROOT.as_posix()}/tests/")
        name, _, parameters = item.name.partition("[")
        for begin, every in THINNED.items():
            if f"{path}::{name}".startswith(begin):
                if seen[begin] % every:
                    item.add_marker(pytest.mark.long)
                seen[begin] += 1
        if item.get_closest_marker("alone") or item.get_closest_marker("real_time"):
            continue
        if f"{path}::{name}".startswith(ALONE):
            item.add_marker(pytest.mark.alone)
        elif (
            f"{path}::{name}".startswith(REAL_TIME) or "wire" in parameters or "emulator" in item.fixturenames
        ):
            if not f"tests/{path}".startswith(_IN_REAL_TIME):
                raise pytest.UsageError(f"{path} talks in real time: name it in WIRED of tests/lanes.py")
            item.add_marker(pytest.mark.real_time)


@pytest.fixture(scope="session")
def public_data():
    base = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data"))
    folder = base / "4wis4wid"
    if not folder.is_dir():
        pytest.skip(f"public recordings not found in {folder}: set HIL_DATA (docs/calibration.md)")
    return folder


@pytest.fixture(scope="module", autouse=True)
def environment_kept():
    """What a library sets for its processes, and the folders of scripts, are not left to the next module."""
    with mock.patch.dict(os.environ), mock.patch.object(sys, "path", list(sys.path)):
        yield


@pytest.fixture(scope="module")
def cycles_alone():
    """Recordings of this module's tests hold cycles and notes, without the topics that ROS 2 would read."""
    from hil.recording.ros_messages import CycleMessages  # loads rosbags

    with mock.patch.object(CycleMessages, "of", return_value=()):
        yield


@pytest.fixture(scope="session")
def template():
    """What commands are forked from."""
    found = warm.Template()
    yield found
    found.close()


@pytest.fixture(scope="module")
def warm_commands(template):
    """Commands that this module's tests and benches start are forked: tests/warm.py."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(warm.Warm, "template", template)
        patch.setattr(subprocess, "Popen", warm.Warm)
        yield


@pytest.fixture
def started_commands(monkeypatch):
    """For one test of such a module: its commands are started anew."""
    monkeypatch.setattr(subprocess, "Popen", warm.STARTED)


@pytest.fixture
def full_disk(monkeypatch):
    """A function that has recordings run out of disk after so many bytes."""

    def limit(capacity):
        whole = mcap_file._WholeWrites.write

        def write(file, data):
            room = capacity - file.tell()
            if len(data) <= room:
                return whole(file, data)
            whole(file, bytes(data)[: max(0, room)])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(mcap_file._WholeWrites, "write", write)

    return limit
