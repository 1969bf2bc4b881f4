"""The pytest plugin: a bench, its world, clock and loop as fixtures, with emulated or real devices.

pytest loads this module in every run of an environment that has the package installed, so it imports
nothing but pytest until a test asks for a bench. Without `--bench` every device is emulated: no
hardware moves unless the command line names it.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from hil.bench import Bench, World
    from hil.core.clock import Clock
    from hil.loop.control_loop import ControlLoop

MARKERS = (
    "needs(*devices): skip unless the bench has these kinds of devices, as its bench file names them, for "
    'example needs("servos", "imu")',
    "fault(device, kind, at=0.0, duration=None, **options): a fault of a device, for example "
    'fault("imu", "silent", at=2.0); seconds of bench time. Of a real device only with --hil-inject-real',
    "real_only: skip where a device is emulated",
    'controller(name, domain=None): a control law, FILE.py:NAME, MODULE:NAME or "ros2:TOPIC" drives every '
    "trajectory of `bench`; ROS 2 uses this DDS domain, by default that of ROS_DOMAIN_ID",
    "opens_stand_ins: the real devices of benches that this test opens itself are not hardware, but pseudo "
    "terminals, loopback or ports of an emulator: they are also opened without --bench",
)
NOT_HELD = "not_held"
"""Property of a test case whose robot lost the hold that it should have: how far it moved, and why."""
_KEPT = "kept"
ATTEMPT = pytest.StashKey[int]()
"""Number of the attempt at a test, from 1: plugins such as pytest-rerunfailures repeat a test that failed."""
OF_A_BENCH = ("bench", "calibration_version", "seed", "emulated", "fault", "controller", "injected", "held")
"""Properties of a bench in a report."""
_OPENED = pytest.StashKey["Bench"]()
_PASSED = pytest.StashKey[bool]()
_FAILED = pytest.StashKey[pytest.TestReport]()
_STAND_INS = pytest.StashKey[bool]()
_SEES = pytest.StashKey[bool]()
_LEFT = pytest.StashKey["dict[str, list[str]]"]()
_INTERRUPTED = pytest.StashKey["list[str]"]()

pytest.register_assert_rewrite("hil.pytest_plugin.selfcheck", "hil.pytest_plugin.contract")


class NotHeldWarning(pytest.PytestWarning):
    """A test without faults has left an emulated robot on its wall without hold."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options `--bench`, `--emulate`, `--hil-*`, and the ini key `hil_bench`."""
    group = parser.getgroup("hil", "hardware in the loop")
    group.addoption(
        "--bench", metavar="FILE", help="bench file or profile; its real devices are used as they are"
    )
    group.addoption(
        "--emulate",
        metavar="NAMES",
        nargs="?",
        const="all",
        type=_devices,
        help="devices of --bench to emulate, separated by commas; all of them without NAMES",
    )
    group.addoption("--hil-seed", metavar="N", type=_seed, default=0, help="seed of every emulated world")
    group.addoption("--hil-realtime", action="store_true", help="emulated devices at the wire, in real time")
    group.addoption(
        "--hil-inject-real",
        action="store_true",
        help="inject faults of real devices at their links, as far as [faults] of the bench file permits",
    )
    group.addoption(
        "--hil-keep",
        metavar="FOLDER",
        help="record every bench, and keep of each failed test its recordings in this folder, with a page",
    )
    group.addoption(
        "--hil-blind-spots",
        metavar="PATTERN",
        nargs="?",
        const="*",
        dest="hil_blind_spots",
        help="run the suite against robots that are broken on purpose (all, or =PATTERN of their names), and "
        "report what no test notices",
    )
    parser.addini("hil_bench", "bench file or profile that is emulated when --bench is not given", default="")


def _seed(text: str) -> int:
    from argparse import ArgumentTypeError

    if not text.strip().isdecimal():
        raise ArgumentTypeError(f"{text!r} is no seed; expected a whole number that is not negative")
    return int(text)


def _devices(text: str) -> str:
    from argparse import ArgumentTypeError

    from hil.core.errors import HilError
    from hil.core.registry import kinds

    try:
        known = kinds()
    except HilError as error:
        raise ArgumentTypeError(str(error)) from None
    wrong = [name for name in text.split(",") if name not in known and name != "all"]
    if wrong:
        raise ArgumentTypeError(
            f"{wrong[0]!r} is not a device; expected all or some of {', '.join(known)}; "
            "in front of a path write --emulate=all"
        )
    return text


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers; from now on reject real devices that the command line does not name."""
    from hil.core.bench_observers import guarded_by

    for line in MARKERS:
        config.addinivalue_line("markers", line)

    def guard(given: Any, checked: Any) -> None:
        from hil.pytest_plugin.bench_selection import refuse_unnamed

        if not config.stash.get(_STAND_INS, False):
            refuse_unnamed(config, given, checked)

    stack = ExitStack()
    stack.enter_context(guarded_by(guard))
    config.add_cleanup(stack.close)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Before any test, reject an invalid bench file, and a real bench shared by several processes."""
    if _named(session.config):
        from hil.pytest_plugin.bench_selection import check_session

        check_session(session.config)
    if session.config.getoption("hil_blind_spots"):
        from hil.pytest_plugin import blind_spots

        blind_spots.check_session(session.config)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """Search for blind spots if requested; otherwise return None to run pytest's own loop."""
    options = session.config.option
    if not options.hil_blind_spots or options.collectonly or session.testsfailed:
        return None
    from hil.pytest_plugin import blind_spots

    blind_spots.run(session)
    return True


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print robots that are not held, files kept of failed tests, and the table of blind spots."""
    _tell(terminalreporter, "robots left NOT HELD", _left(terminalreporter, NOT_HELD))
    _tell(terminalreporter, "kept of failed tests", sorted(_left(terminalreporter, _KEPT)))
    _tell(terminalreporter, "left when the session was interrupted", config.stash.get(_INTERRUPTED, []))
    session = terminalreporter._session
    if config.getoption("hil_blind_spots") and session is not None:
        from hil.pytest_plugin import blind_spots

        found = session.stash.get(blind_spots.FOUND, None)
        if found:
            blind_spots.summary(terminalreporter, found)


def _ended(reporter: Any) -> list[pytest.TestReport]:
    """Return the last report of every test."""
    reports = [one for some in reporter.stats.values() for one in some]
    return [report for report in reports if getattr(report, "when", "") == "teardown"]


def _left(reporter: Any, what: str) -> list[str]:
    """Return lines on what all attempts at the tests have left, each line once."""
    reports = _ended(reporter)
    return list(dict.fromkeys(line for r in reports for line in getattr(r, "hil_left", {}).get(what, ())))


def _tell(reporter: Any, title: str, lines: list[str]) -> None:
    if lines:
        reporter.section(title)
    for line in lines:
        reporter.write_line(line)


def _named(config: pytest.Config) -> bool:
    return bool(config.getoption("bench") or config.getini("hil_bench"))


def pytest_report_header(config: pytest.Config) -> str | None:
    """Return a line about the bench, if one was named."""
    if not _named(config):
        return None
    from hil.pytest_plugin.bench_selection import describe

    return describe(config)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Begin an attempt, without the properties of earlier ones; skip a test that this bench cannot run."""
    item.stash[ATTEMPT] = item.stash.get(ATTEMPT, 0) + 1
    if item.stash[ATTEMPT] > 1:
        item.user_properties[:] = [p for p in item.user_properties if p[0] not in (*OF_A_BENCH, NOT_HELD)]
    if any(item.get_closest_marker(name) for name in ("needs", "fault", "real_only", "controller")):
        from hil.pytest_plugin.bench_selection import skip_where_impossible

        skip_where_impossible(item)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, None, None]:
    """Register every bench that is opened during a test."""
    from hil.core.bench_observers import on_bench_opened

    def opened(found: Bench) -> None:
        from hil.pytest_plugin.benches_of_tests import see

        item.config.stash[_SEES] = True
        see(item, found)

    with stand_ins_of(item), on_bench_opened(opened):
        yield


@contextmanager
def stand_ins_of(item: pytest.Item) -> Generator[None, None, None]:
    """Within the block, allow the real devices of the benches that a test marked `opens_stand_ins` opens."""
    stash = item.config.stash
    stash[_STAND_INS] = item.get_closest_marker("opens_stand_ins") is not None
    try:
        yield
    finally:
        stash[_STAND_INS] = False


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, None]:
    """Add to a failure how to repeat it; at teardown report the benches of the test and their state."""
    outcome = yield
    report = outcome.get_result()
    opened = item.stash.get(_OPENED, None)
    if report.failed:
        item.stash.setdefault(_FAILED, report)
        if opened is not None:
            from hil.pytest_plugin.bench_selection import how_to_repeat

            report.sections.append(("bench", how_to_repeat(item, opened)))
        if item.config.stash.get(_SEES, False):
            from hil.pytest_plugin.benches_of_tests import seen_by_benches

            if told := seen_by_benches(item):
                report.sections.append(("what the bench saw", told))
    if report.when == "call":
        item.stash[_PASSED] = report.passed
    elif report.when == "teardown":
        _end(item, report)


def _end(item: pytest.Item, report: pytest.TestReport) -> None:
    """Add to the last report of a test the benches that it opened itself, and its kept files."""
    if item.config.stash.get(_SEES, False):
        from hil.pytest_plugin.benches_of_tests import end_test

        kept = end_test(item, report, item.stash.get(_OPENED, None), item.stash.get(_FAILED, None))
        left: dict[str, list[str]] = item.stash.setdefault(_LEFT, {NOT_HELD: [], _KEPT: []})
        left[NOT_HELD] += [
            f"{item.nodeid}: {why}" for name, why in report.user_properties if name == NOT_HELD
        ]
        left[_KEPT] += kept
        vars(report)["hil_left"] = left  # for the terminal summary, also from an xdist worker
    keys: tuple[pytest.StashKey[Any], ...] = (_OPENED, _FAILED)
    for key in keys:
        if key in item.stash:
            del item.stash[key]


@pytest.hookimpl(tryfirst=True)
def pytest_keyboard_interrupt(excinfo: pytest.ExceptionInfo[BaseException]) -> None:
    """Prepare the report of a session that a signal ends, wherever the signal met it."""
    from hil.pytest_plugin.traceback_lines import with_lines

    with_lines(excinfo.tb)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """After the last teardown, finish recordings that are still open."""
    if session.config.stash.get(_SEES, False):
        from hil.pytest_plugin.benches_of_tests import end_session

        interrupted = exitstatus == pytest.ExitCode.INTERRUPTED
        session.config.stash[_INTERRUPTED] = end_session(session.config, interrupted=interrupted)


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Generator[Bench, None, None]:
    """An open bench for each test: new world, devices open; at the end the robot is held, the bench closed.

    The report of the test then contains how the robot was left.
    """
    from hil.pytest_plugin.bench_selection import injected, opened
    from hil.pytest_plugin.test_outcome import end

    item = request.node
    item.stash[_PASSED] = False
    with opened(item) as found:
        item.stash[_OPENED] = found
        yield found
    item.user_properties += injected(found)
    end(item, found, passed=item.stash[_PASSED])


@pytest.fixture
def world(bench: Bench) -> World:
    """The emulated world of `bench`; skips the test if the world is not in this process."""
    if bench.world is None:
        pytest.skip(f"bench {bench.config.name}: the world is not in this process (real or at the wire)")
    return bench.world


@pytest.fixture
def clock(bench: Bench) -> Clock:
    """The clock of `bench`: virtual if everything is emulated in this process."""
    return bench.clock


@pytest.fixture
def loop(bench: Bench) -> ControlLoop:
    """A control loop over `bench` that reads and estimates, but sends no commands."""
    from hil.recording.runs import RunStart

    feedback = "ekf"
    start = RunStart(bench.start_state(), feedback)
    return bench.make_loop(bench.make_pipeline(None, feedback=feedback), start)
