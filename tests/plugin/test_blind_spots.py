"""`pytest --hil-blind-spots` reports which broken robot a suite does not notice."""

import pytest

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("warm_commands")
BENCH = """
schema = 1
name = "small"

[imu]
backend = "emulated"

[environment]
surface = "floor"
tilt_rad = 0.0
"""
LOOKS = """
import numpy as np

def test_it_feels_gravity_and_no_rotation(bench):
    motion = bench.observe(2.0, feedback="odometry")
    samples = [s for r in motion.records for s in r.inputs.imu if r.start_ns > 1_500_000_000]
    assert len(samples) > 20
    assert all(s.status.value == "ok" for s in samples)
    assert np.ptp([s.gyro_rad_s for s in samples], axis=0).max() > 0.0
    assert np.abs([s.gyro_rad_s for s in samples]).max() < 0.05
"""
LOOKS_AWAY = "def test_nothing(bench):\n    assert bench.has('imu')\n"


@pytest.fixture
def searched(pytester):
    def run(text, pattern):
        (pytester.path / "bench.toml").write_text(BENCH)
        pytester.makepyfile(test_it=text)
        return pytester.runpytest_subprocess("--bench=bench.toml", f"--hil-blind-spots={pattern}")

    return run


def test_a_breakage_that_a_test_notices_is_none_and_the_test_is_named(searched):
    result = searched(LOOKS, "imu:[sw]*")
    result.stdout.fnmatch_lines(["imu:stuck *test_it.py::test_it_feels_gravity_and_no_rotation"])
    result.stdout.fnmatch_lines(["*broken robots: * 0 blind spots"])
    assert result.ret == 0


def test_a_breakage_that_no_test_notices_fails_the_session(searched):
    result = searched(LOOKS_AWAY, "imu:[sd]*")
    result.stdout.fnmatch_lines(["imu:stuck *BLIND: no test notices it"])
    result.stdout.fnmatch_lines(["imu:duplicate *by no test, and it is of a kind that a bench tolerates"])
    assert result.ret == 1


def test_a_suite_with_stand_ins_for_hardware_is_searched_as_well(searched):
    opens = """
import hil
import pytest
from hil.config.loading import load_bench

@pytest.mark.opens_stand_ins
def test_stand_ins():
    other = load_bench("bench.toml", overrides={"imu.backend": "real", "imu.port": "/dev/null"})
    hil.open_bench(other).close()
"""
    assert searched(LOOKS + opens, "imu:stuck").ret == 0


def test_a_breakage_that_there_is_not_is_refused_with_those_that_there_are(searched):
    result = searched(LOOKS, "imu:stuk")
    result.stderr.fnmatch_lines(["*imu:stuk: no such breakage*imu:stuck*"])
    assert result.ret == 4


@pytest.mark.long
def test_real_robots_are_not_broken_on_purpose(searched, pytester):
    (pytester.path / "real.toml").write_text(BENCH.replace('backend = "emulated"', 'port = "/dev/null"'))
    pytester.makepyfile(test_it=LOOKS)
    result = pytester.runpytest_subprocess("--bench=real.toml", "--hil-blind-spots")
    result.stderr.fnmatch_lines(["*imu of bench small are real*"])
    assert result.ret == 4
