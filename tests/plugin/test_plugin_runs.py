"""The pytest plugin as a user meets it: pytest in a process of its own, in a project of its own."""

import re
from contextlib import nullcontext
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from hil.calibration.calibration_file import save_calibration
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.signals import Stamp, Status
from hil.loop.timing import LoopStatistics
from hil.procedure.bench_source import BenchSource
from hil.pytest_plugin import selfcheck
from hil.pytest_plugin.selfcheck import idle_for, oldest_s, too_late
from tests.procedures.made_calibrations import made

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("warm_commands")

LAB = """
schema = 1
name = "lab"
{calibration}

[environment]
surface = "floor"
tilt_rad = 0.0

[imu]
backend = "real"
port = "/dev/no-such-port"

[encoders]
backend = "emulated"
"""


@pytest.fixture
def run(pytester):
    """Runs pytest on test files in a fresh project; outcome and properties by test from its JUnit XML."""

    def go(*options, **files):
        pytester.makepyfile(**files)
        result = pytester.runpytest_subprocess("--junitxml=junit.xml", *options)
        found = {}
        if (pytester.path / "junit.xml").exists():
            for case in ElementTree.parse(pytester.path / "junit.xml").iter("testcase"):
                found[case.get("name")] = SimpleNamespace(
                    outcome=next((e.tag for e in case if e.tag in ("skipped", "failure", "error")), "passed"),
                    message=next((e.get("message") for e in case if e.get("message")), ""),
                    text="".join(e.text or "" for e in case),
                    properties={p.get("name"): p.get("value") for p in case.iter("property")},
                )
        return result, found

    return go


FIXTURES = """
import numpy as np
import pytest

from hil.replay.recordings import open_recording
from hil.replay.verification import verify_run
from hil.recording.mcap_writer import McapRecorder

began = []

def test_the_fixtures_are_one_bench(bench, world, clock, loop):
    assert bench.world is world
    assert bench.clock is clock
    assert clock.now_ns() == world.now_ns > 0
    records = []
    loop.run(lambda record: records.append(record) or len(records) == 20)
    assert np.isfinite(records[-1].state.pose_body_in_wall).all()
    assert len(records[-1].inputs.servos) == 1

@pytest.fixture
def recorder(bench, tmp_path):
    recorder = McapRecorder(tmp_path / "loop.mcap", bench.header(), lossless=True)
    bench.add_sink(recorder)
    return recorder

def test_a_recorded_loop_can_be_replayed(bench, recorder, loop, tmp_path):
    loop.run(lambda record: record.cycle == 19)
    bench.remove_sink(recorder)
    opened = open_recording(tmp_path / "loop.mcap")
    verified = verify_run(opened.bench, opened.run(0))
    assert (verified["cycles"], verified["difference"]) == (20, None)

@pytest.mark.parametrize("again", [False, True])
def test_every_test_has_a_world_of_its_own(bench, again):
    began.append(bench.clock.now_ns())
    motion = bench.observe(0.1)
    began.append(motion.records[-1].inputs.servos[-1].position_rad.tobytes())
    assert began[:2] == began[-2:]

@pytest.mark.needs("can", "mocap")
@pytest.mark.needs("servos")
def test_what_the_bench_has(bench):
    assert bench.seed == 7

def rates(bench):
    return [tuple(s.gyro_rad_s) for r in bench.observe(1.0).records for s in r.inputs.imu]

class TestStuck:
    pytestmark = pytest.mark.fault("imu", "stuck", at=0.0)

    def test_a_marker_of_the_class(self, bench):
        assert len(set(rates(bench)[-30:])) == 1

    @pytest.mark.fault("can", "off", at=0.6)
    def test_and_one_of_the_test(self, bench):
        records = bench.observe(1.0).records
        assert any(r.inputs.encoders for r in records[:5])
        assert not records[-1].inputs.encoders

def test_no_fault_without_a_marker(bench):
    assert len(set(rates(bench)[-30:])) > 1

@pytest.mark.real_only
def test_only_on_hardware(bench):
    raise AssertionError

@pytest.mark.fault("imu", "bus_off")
def test_impossible_fault(bench):
    raise AssertionError

@pytest.mark.needs()
def test_needs_nothing(bench):
    pass


@pytest.mark.needs("camera")
def test_called_as_people_do(bench):
    pass

@pytest.mark.needs("radar")
def test_unknown_device():
    raise AssertionError

@pytest.mark.fault("imu")
def test_half_a_fault(bench):
    raise AssertionError

@pytest.mark.fault("mocap", "off", at=1.5, duration=0.5)
def test_that_fails(bench):
    assert False
"""


def ran(cycles, late):
    found = LoopStatistics(cycles=cycles, late=late)
    found.add({"work": 5_000_000, "read": 3_000_000})
    return found


@pytest.mark.parametrize(
    ("late", "before", "after", "problem"),
    [(15, 0, 0, False), (16, 0, 0, True), (100, 0, 30, False), (100, 20, 20, True)],
)
def test_late_cycles_are_held_against_an_idle_loop(late, before, after, problem):
    assert bool(too_late(ran(1500, late), (ran(500, before), ran(500, after)))) is problem


@pytest.mark.parametrize(
    ("late", "idle", "outcome"), [(60, 20, "passed"), (60, 5, "failed"), (300, 60, "skipped")]
)
def test_a_computer_too_busy_to_tell_is_said_to_be(late, idle, outcome):
    watch = SimpleNamespace(bench=SimpleNamespace(statistics=ran(1500, late)), idle=(ran(500, idle),))
    expected = {
        "passed": nullcontext(),
        "failed": pytest.raises(AssertionError, match=f"{late} of 1500 cycles were late"),
        "skipped": pytest.raises(pytest.skip.Exception),
    }
    with expected[outcome]:
        selfcheck.test_the_loop_keeps_its_rate(watch)


def camera(*statuses):
    """A watch of a camera at 100 Hz whose samples have these statuses."""
    samples = [
        SimpleNamespace(stamp=Stamp(k * 10**7, k * 10**7, k), status=s) for k, s in enumerate(statuses)
    ]
    bench = SimpleNamespace(config=load_bench("emulated"))
    return SimpleNamespace(bench=bench, duration_s=len(samples) / 100.0, samples=lambda device: samples)


@pytest.mark.parametrize(
    ("statuses", "good"),
    [
        ([Status.LOW_CONFIDENCE] * 25 + [Status.OK] * 175, True),
        ([Status.OK] * 100 + [Status.LOW_CONFIDENCE] * 25 + [Status.OK] * 75, False),
        ([Status.TIMEOUT] * 25 + [Status.OK] * 175, False),
    ],
)
def test_a_camera_may_settle_at_the_start_of_a_short_watch(monkeypatch, statuses, good):
    monkeypatch.setattr(selfcheck, "due", lambda *given: 200.0)
    reported = nullcontext() if good else pytest.raises(AssertionError, match="tracker: ")
    with reported:
        selfcheck.test_samples_come_at_their_rate_and_nearly_all_are_good(camera(*statuses), "tracker")


def test_an_idle_loop_runs_at_the_benchs_rate():
    source = BenchSource("emulated", realtime=True, overrides={"loop.rate_hz": 50.0})
    begun_ns = MonotonicClock().now_ns()
    (found,) = idle_for(source, 0.2)
    assert MonotonicClock().now_ns() - begun_ns >= 200_000_000
    assert found.cycles == 10


def test_samples_that_were_asked_for_ahead_may_be_a_cycle_older():
    source = BenchSource("emulated", realtime=True)
    assert oldest_s(source.config, "servos") == pytest.approx(0.035)
    assert oldest_s(BenchSource("emulated").config, "servos") == pytest.approx(0.025)
    assert oldest_s(source.config, "tracker") == pytest.approx(0.25)
    slow = BenchSource("emulated", overrides={"loop.rate_hz": 25.0, "thrust.model": "vesc"})
    assert oldest_s(slow.config, "thrust") == pytest.approx(0.065), "they wait for the loop in a queue"


@pytest.mark.usefixtures("started_commands")
def test_fixtures_and_markers_on_the_emulated_bench(run):
    result, found = run("-rs", "-p", "no:cacheprovider", "-W", "error", "--hil-seed=7", test_all=FIXTURES)
    outcomes = {name: case.outcome for name, case in found.items()}
    assert outcomes == {
        "test_the_fixtures_are_one_bench": "passed",
        "test_a_recorded_loop_can_be_replayed": "passed",
        "test_every_test_has_a_world_of_its_own[False]": "passed",
        "test_every_test_has_a_world_of_its_own[True]": "passed",
        "test_what_the_bench_has": "passed",
        "test_a_marker_of_the_class": "passed",
        "test_and_one_of_the_test": "passed",
        "test_no_fault_without_a_marker": "passed",
        "test_only_on_hardware": "skipped",
        "test_impossible_fault": "error",
        "test_needs_nothing": "error",
        "test_called_as_people_do": "error",
        "test_unknown_device": "error",
        "test_half_a_fault": "error",
        "test_that_fails": "failure",
    }, result.stdout.str()
    for case in found.values():
        if case.outcome in ("passed", "failure", "skipped"):
            wanted = {"bench": "emulated", "calibration_version": "none", "seed": "7"}
            assert case.properties.items() >= wanted.items()
    assert found["test_that_fails"].properties["fault"] == "mocap:off@1.5+0.5"
    for name, named in (
        ("test_only_on_hardware", "servos"),
        ("test_impossible_fault", "bus_off"),
        ("test_called_as_people_do", "did you mean tracker"),
        ("test_unknown_device", "needs('radar')"),
        ("test_needs_nothing", "needs()"),
        ("test_half_a_fault", "at=seconds"),
    ):
        assert named in found[name].message
    said = result.stdout.str()
    assert "repeat with --hil-seed=7" in said
    assert "warnings summary" not in said
    assert re.search(r"SKIPPED \[1\] test_all.py:\d+: real_only", said)
    assert not re.search(r"site-packages|hil/pytest_plugin", found["test_impossible_fault"].text)


ON_A_LAB = """
import pytest

def test_it_opens(bench):
    assert bench.has("imu")

@pytest.mark.needs("servo")
def test_with_a_servo(bench):
    raise AssertionError

@pytest.mark.needs("mocap")
def test_with_mocap(bench):
    raise AssertionError

@pytest.mark.fault("imu", "stuck")
def test_with_a_fault(bench):
    pass

@pytest.mark.fault("servo.drive_FL", "off")
def test_with_a_fault_of_a_servo(bench):
    raise AssertionError

@pytest.mark.real_only
@pytest.mark.needs("imu")
def test_on_hardware():
    pass

@pytest.mark.real_only
def test_all_on_hardware():
    raise AssertionError

def test_that_needs_the_world(world):
    assert world.now_ns > 0
"""

EMULATED = {
    "test_it_opens": "passed",
    "test_with_a_servo": "skipped",
    "test_with_mocap": "skipped",
    "test_with_a_fault": "passed",
    "test_with_a_fault_of_a_servo": "skipped",
    "test_on_hardware": "skipped",
    "test_all_on_hardware": "skipped",
    "test_that_needs_the_world": "passed",
}


def lab(pytester):
    """A bench file with a real device and a calibration, in the project."""
    save_calibration(pytester.path / "calibration.toml", made(version=3, made_for=None))
    (pytester.path / "lab.toml").write_text(LAB.format(calibration='calibration = "calibration.toml"'))


def test_a_bench_that_is_not_named_on_the_command_line_is_emulated(run, pytester):
    lab(pytester)
    pytester.makeini("[pytest]\nhil_bench = lab.toml\n")
    result, found = run(test_lab=ON_A_LAB)
    assert {name: case.outcome for name, case in found.items()} == EMULATED, result.stdout.str()
    assert "mocap" in found["test_with_mocap"].message
    assert "servos" in found["test_with_a_fault_of_a_servo"].message
    for case in found.values():
        assert case.properties.items() >= {"bench": "lab", "calibration_version": "3"}.items()
    result.stdout.fnmatch_lines("hil: bench lab, seed 0; emulated: encoders, imu; real: none")


def test_real_devices_of_a_bench_that_is_named_are_used(run, pytester):
    lab(pytester)
    result, found = run("--bench=lab.toml", "-k", "not world", test_lab=ON_A_LAB)
    assert found["test_it_opens"].outcome == "error"
    assert "/dev/no-such-port" in found["test_it_opens"].message
    assert not re.search(r"site-packages|hil/drivers", found["test_it_opens"].text)
    assert found["test_with_a_fault"].outcome == "skipped"
    assert found["test_on_hardware"].outcome == "passed"
    assert found["test_all_on_hardware"].outcome == "skipped"
    result.stdout.fnmatch_lines("hil: bench lab, seed 0; emulated: encoders; real: imu")


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (["--bench=nowhere.toml"], "nowhere.toml"),
        (["-o", "hil_bench=bad.toml"], "colour"),
        (["--emulate", "test_lab.py"], "--emulate=all"),
    ],
)
def test_a_wrong_bench_ends_the_run_before_the_first_test(pytester, options, reported):
    pytester.makefile(".toml", bad='schema = 1\nname = "bad"\ncolour = "red"\n')
    pytester.makepyfile(test_lab="def test_never():\n    raise AssertionError\n")
    result = pytester.runpytest(*options)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert reported in result.stderr.str()


STRANGER = """
import sys

def test_nothing_of_the_bench_is_loaded():
    loaded = {name.partition(".")[0] for name in sys.modules}
    assert not loaded & {"numpy", "scipy", "pydantic", "can", "serial"}
    light = {"hil.pytest_plugin", "hil.core", "hil.core.bench_observers"}
    assert {name for name in sys.modules if name.startswith("hil.")} <= light

def test_own_fixtures_win(bench, loop):
    assert (bench, loop) == ("mine", "mine too")
"""


@pytest.mark.usefixtures("started_commands")
def test_a_project_that_asks_for_no_bench_pays_nothing(run):
    conftest = """
        import pytest

        @pytest.fixture
        def bench():
            return "mine"

        @pytest.fixture
        def loop(bench):
            return bench + " too"
        """
    result, found = run(
        "-W",
        "error",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:hypothesispytest",
        test_stranger=STRANGER,
        conftest=conftest,
    )
    assert [case.outcome for case in found.values()] == ["passed", "passed"], result.stdout.str()
    assert not any(case.properties for case in found.values())
    assert "hil" not in next(line for line in result.outlines if line.startswith("rootdir"))


def test_a_real_bench_is_not_shared_by_two_processes(pytester):
    pytest.importorskip("xdist", reason="pytest-xdist is not installed")
    lab(pytester)
    refused = pytester.runpytest_subprocess("-n2", "--bench=lab.toml")
    assert refused.ret == pytest.ExitCode.USAGE_ERROR
    assert "imu" in refused.stderr.str()


@pytest.mark.long
def test_two_processes_share_an_emulated_bench(run, pytester):
    pytest.importorskip("xdist", reason="pytest-xdist is not installed")
    lab(pytester)
    result, found = run("-n2", "--bench=lab.toml", "--emulate", test_lab=ON_A_LAB)
    assert {name: case.outcome for name, case in found.items()} == EMULATED, result.stdout.str()
    assert {case.properties["bench"] for case in found.values()} == {"lab"}
