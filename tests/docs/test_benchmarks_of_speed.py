"""`make bench`: figures are read out of what the benchmarks print, and growth is told by its exponent."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GROWTH = runpy.run_path(str(ROOT / "benchmarks" / "growth.py"))
TABLE = runpy.run_path(str(ROOT / "benchmarks" / "table.py"))
START = runpy.run_path(str(ROOT / "benchmarks" / "start.py"))
NOT_FOR_DRIVING = {
    "matplotlib",
    "mujoco",
    "packaging",
    "pyarrow",
    "rich",
    "jinja2",
    "distributed",
    "rerun",
    "hil.recording.public_csv",
    "hil.recording.rosbag",
    "hil.calibration.calibrate",
    "hil.report.run_page",
}


@pytest.mark.parametrize("power", [1, 2])
def test_an_exponent_tells_linear_from_quadratic(power, monkeypatch):
    spent_s = [0.0]
    monkeypatch.setattr("time.process_time", lambda: spent_s[0])

    def work(size):
        def spend():
            spent_s[0] += 0.01 * size**power

        return spend

    found = GROWTH["measure"]((size, work(size)) for size in (1.0, 2.0, 4.0))
    assert found["sizes"] == [1.0, 2.0, 4.0]
    assert found["exponent"] == power


def test_what_a_rig_reads_is_what_was_asked_for():
    names = [name for name, _ in GROWTH["devices"]()]
    assert names == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert set(GROWTH["DIMENSIONS"]) == {"recordings", "rate", "devices", "history", "runs"}


def test_a_ratio_is_how_many_times_as_good_ours_is():
    told = {"ekf": {"ours_us": 20.0, "filterpy_us": 400.0}}
    assert [row.ratio for row in TABLE["of_estimator"](told)] == [20.0]
    told = {
        "sync_read": {
            "ours_hz": 200.0,
            "sdk_hz": 100.0,
            "ours_cpu_us_per_cycle": 4,
            "sdk_cpu_us_per_cycle": 2,
        }
    }
    assert [row.ratio for row in TABLE["of_servo_bus"](told)] == [2.0, 0.5]
    told = {"cost": {"ours_ms": 1.5, "loop_ms": 300.0}}
    assert [row.ratio for row in TABLE["of_calibration"](told)] == [200.0]


def test_a_run_loads_what_it_drives_with_and_nothing_else_before_it_drives():
    share, loaded = START["imports"]("steering_zero")
    assert 0.1 < share < 1.0
    assert {"hil.ring.loop", "hil.drivers.servos"} <= set(loaded)
    assert not NOT_FOR_DRIVING & set(loaded)


@pytest.mark.long
def test_the_table_is_printed_and_left_as_json_and_picture(tmp_path):
    command = [
        sys.executable,
        "benchmarks/table.py",
        "--only",
        "plant,virtual_bench,growth",
        "--out",
        str(tmp_path),
    ]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    facts = json.loads((tmp_path / "bench.json").read_text())
    assert [row["what"] for row in facts["rows"]] == [
        "physics of the robot alone",
        "emulated rig in virtual time",
    ]
    assert set(facts["growth"]) == set(GROWTH["DIMENSIONS"])
    assert all(row["what"] in told.stdout for row in facts["rows"])
    assert "exponent" in (tmp_path / "bench.svg").read_text()
