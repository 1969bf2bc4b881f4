"""For all tests: public recordings, property tests without limits of wall-clock time, who needs the clock."""

import errno
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy comes; as the command line does

import pytest
from hypothesis import settings

from hil.recording import mcap_file

settings.register_profile("hil", deadline=None)
settings.load_profile("hil")
ROOT = Path(__file__).resolve().parents[1]
REAL_TIME = (
    "adhesion/test_keeper_killed.py", "adhesion/test_keeper_process.py",
    "emulate/", "live/", "bench/test_bench_assembly.py", "bench/test_doctor_slow_adapter.py",
    "core/test_loop_and_server.py", "devices/test_guide.py", "encoders/test_can_face.py",
    "imu/test_imu_on_a_pty.py",
    "imu_microstrain/test_microstrain_on_a_pty.py", "imu_microstrain/test_microstrain_on_a_bench.py",
    "mocap/test_mocap_flood.py", "mocap/test_mocap_udp.py", "monitor/test_monitor_listens.py",
    "servos/test_servo_on_a_pty.py", "tracker/test_tracker_across_processes.py",
    "tracker_mavlink/test_mavlink_links.py", "tracker_mavlink/test_mavlink_on_the_bench.py",
)  # fmt: skip
"""Tests that talk in real time, by how their path begins; so do all with `wire` among their parameters."""


def pytest_configure(config):
    config.addinivalue_line("markers", "real_time: talks in real time; runs alone, not beside other tests")


def pytest_collection_modifyitems(items):
    for item in items:
        path = item.path.as_posix().removeprefix(f"{ROOT.as_posix()}/tests/")
        if path.startswith(REAL_TIME) or "wire" in item.name.partition("[")[2]:
            item.add_marker(pytest.mark.real_time)


@pytest.fixture(scope="session")
def public_data():
    base = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data"))
    folder = base / "4wis4wid"
    if not folder.is_dir():
        pytest.skip(f"public recordings not found in {folder}: set HIL_DATA (docs/calibration.md)")
    return folder


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
