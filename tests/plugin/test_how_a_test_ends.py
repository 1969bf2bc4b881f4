"""What the plugin says of a test that leaves its robot falling, or in which a fault had no part."""

from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from hil.bench.hold.held_state import Held
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan
from hil.pytest_plugin import test_outcome

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("warm_commands")

LOST = """
import pytest

def wait(bench, duration_s):
    bench.clock.sleep_until_ns(bench.clock.now_ns() + int(duration_s * 1e9))

@pytest.mark.fault("plant", "adhesion_loss", at=1.0)
def test_lost_on_purpose(bench):
    wait(bench, 2.0)

def test_lost(bench):
    bench.devices.get("adhesion").set_duty(0.05)
    wait(bench, 3.0)

def test_kept(bench):
    pass

def test_torque_off(bench):
    bench.devices.servos.release()
    wait(bench, 0.5)
"""


def run(pytester, text, *options):
    """Outcome, and the properties of every test from its JUnit XML."""
    pytester.makepyfile(test_mine=text)
    result = pytester.runpytest_subprocess("--junitxml=junit.xml", "-p", "no:cacheprovider", *options)
    cases = ElementTree.parse(pytester.path / "junit.xml").iter("testcase")
    return result, {
        case.get("name"): {p.get("name"): p.get("value") for p in case.iter("property")} for case in cases
    }


def test_a_robot_that_is_lost_is_named_and_is_a_warning_where_no_fault_did_it(pytester):
    result, found = run(pytester, LOST)
    result.assert_outcomes(passed=4, warnings=2)
    result.stdout.fnmatch_lines(
        [
            "*NotHeldWarning: bench emulated: the test has left the robot NOT HELD: *",
            "*= robots left NOT HELD =*",
            "test_mine.py::test_lost_on_purpose: NOT HELD: *adhesion is lost*",
            "test_mine.py::test_lost: NOT HELD: *adhesion is lost*",
            "test_mine.py::test_torque_off: NOT HELD: *torque was switched off*",
        ],
        consecutive=False,
    )
    assert {name: seen["held"] for name, seen in found.items()} == {
        "test_lost_on_purpose": "NOT HELD",
        "test_lost": "NOT HELD",
        "test_kept": "HELD",
        "test_torque_off": "NOT HELD",
    }
    assert "adhesion is lost" in found["test_lost"]["not_held"]
    assert "not_held" not in found["test_kept"]


SEEN = """
import pytest

@pytest.mark.fault("imu", "off", at=1.2)
def test_seen(bench):
    bench.observe(1.5, feedback="odometry")
    assert bench.clock is None
"""


def test_what_the_bench_saw_is_with_the_test(pytester):
    result, found = run(pytester, SEEN)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*what the bench saw*", "1.* s, warning, imu: stale for 0.* s"])
    assert "warning, imu: stale for" in found["test_seen"]["event"]


def item(warned, *, real=(), fails=False, blind=None):
    """A test as `end` needs it."""

    def warn(warning):
        warned.append(warning)
        if fails:
            raise warning

    return SimpleNamespace(
        user_properties=[],
        add_report_section=lambda *reported: None,
        warn=warn,
        iter_markers=lambda name: (),
        source=SimpleNamespace(real=real),
        config=SimpleNamespace(getoption=lambda name: blind),
    )


@pytest.mark.parametrize(
    ("real", "wire", "faults", "fails", "raised", "warns"),
    [
        (("servos",), True, ("imu:off",), False, True, 0),
        ((), True, (), False, True, 0),
        ((), True, ("imu:off",), False, False, 0),
        ((), False, (), False, False, 1),
        ((), False, (), True, True, 1),
        ((), False, ("imu:off",), False, False, 0),
    ],
)
def test_a_lost_robot_is_an_error_where_it_matters(monkeypatch, real, wire, faults, fails, raised, warns):
    warned = []
    monkeypatch.setattr(test_outcome, "source_of", lambda _: tested.source)
    tested = item(warned, real=real, fails=fails)
    bench = SimpleNamespace(
        config=SimpleNamespace(name="lab"),
        held=Held("NOT HELD", None, "it fell"),
        faults=faults,
        faults_not_met=tuple,
        faults_without_effect=tuple,
        world=None if wire else SimpleNamespace(faults=SimpleNamespace(touched=bool(faults))),
    )
    if raised:
        with pytest.raises(pytest.fail.Exception, match="bench lab: the test has left the robot NOT HELD"):
            test_outcome.end(tested, bench, passed=True)
    else:
        test_outcome.end(tested, bench, passed=True)
    assert len(warned) == warns
    assert ("held", "NOT HELD") in tested.user_properties


def test_a_robot_that_was_let_go_of_is_no_error(monkeypatch):
    tested = item([], real=("servos",))
    monkeypatch.setattr(test_outcome, "source_of", lambda _: tested.source)
    held = Held("NOT HELD", None, "torque was released, as exit.policy asks", wanted=False)
    test_outcome.end(
        tested, SimpleNamespace(held=held, faults_not_met=tuple, faults_without_effect=tuple), passed=True
    )
    assert tested.user_properties == [("held", "NOT HELD")]


FAULTS = """
import numpy as np
import pytest

import hil

@pytest.mark.fault("imu", "off", at=1000)
@pytest.mark.fault("imu", "stuck", at=0.1)
def test_too_short(bench):
    bench.observe(0.1)

@pytest.mark.fault("imu", "silent", at=1, duration=1)
def test_too_late(bench):
    bench.clock.sleep_until_ns(3_000_000_000)
    bench.observe(0.1)

@pytest.mark.fault("imu", "off", at=1000)
def test_that_fails(bench):
    assert False

@pytest.mark.fault("imu", "off", at=1000)
def test_that_skips(bench):
    pytest.skip("not today")

@pytest.mark.fault("imu", "off")
def test_without_bench():
    pass

@pytest.mark.fault("imu", "off")
def test_with_a_bench_of_its_own():
    hil.open_bench("emulated")

@pytest.mark.fault("imu", "offf")
def test_wrong_kind():
    pass

@pytest.mark.fault("imu", "off", at=0.1)
def test_with_the_world(world):
    world.sync_plant()

@pytest.mark.fault("imu", "off", at=True)
def test_time_that_is_a_switch(bench):
    pass

@pytest.mark.fault("imu", "off", at=np.int64(0), duration=np.float32(1e-9))
def test_of_a_nanosecond(bench):
    pass

@pytest.mark.fault("imu", "stuck", at=np.int64(0), duration=np.int32(2))
def test_times_of_numpy(bench):
    pass
"""


def test_a_fault_that_has_no_part_in_its_test_is_an_error(pytester):
    result, _ = run(pytester, FAULTS, "-rA")
    said = result.stdout.str()
    for line in (
        "ERROR at teardown of test_too_short",
        "ERROR at teardown of test_too_late",
        "*fault imu:silent@1+1 was over before the first control cycle*",
        "*fault imu:off@1000 never acted*",
        "*marker fault for imu:off@0: the test does not use the fixture `bench`*",
        "*marker fault('imu', 'offf')*did you mean off?",
        "at=True of the marker fault('imu', 'off', at=True)*",
        "fault imu:off has start 0 s and duration 1e-09 s*",
    ):
        result.stdout.fnmatch_lines(f"*{line}*")
    assert "at teardown of test_that" not in said
    reports, _, _ = said.partition("short test summary info")  # where CI is set, it quotes each error in full
    assert reports.count("does not use the fixture") == 2
    result.assert_outcomes(passed=4, failed=1, skipped=1, errors=7)


@pytest.mark.parametrize("given", ["-1", ""])
def test_a_seed_that_is_none_ends_the_run_before_the_first_test(pytester, given):
    pytester.makepyfile(test_mine="def test_never(bench):\n    raise AssertionError\n")
    result = pytester.runpytest(f"--hil-seed={given}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(f"*argument --hil-seed: '{given}'*")


def test_a_plan_remembers_that_it_had_faults():
    plan = FaultPlan()
    assert not plan.touched
    plan.declare("imu", {"off": ()})
    plan.add(parse_fault("imu:off"))
    plan.clear()
    assert (plan.empty, plan.touched) == (True, True)
