"""`pytest --hil-blind-spots`: runs the suite on robots with injected faults, and lists undetected ones.

First the suite runs on the sound robot, and has to pass. Then it runs on every broken robot, quick modules
first, until a test fails, which has then noticed the breakage. A breakage that no test notices is a blind
spot. The session fails if there is a blind spot that matters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

import pytest
from _pytest.runner import runtestprotocol
from _pytest.terminal import TerminalReporter

from hil.core.errors import HilError, did_you_mean
from hil.core.registry import kinds
from hil.fault_matrix import is_tested_itself
from hil.faults.fault import Fault, make_fault
from hil.procedure.bench_source import BenchSource
from hil.pytest_plugin import stand_ins_of
from hil.pytest_plugin.bench_selection import in_several_processes, source_of, use_source

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig

AT_S = 1.0
"""World time at which a fault begins, s: after the devices were opened, before the robot has moved far."""
_BORNE = ("drop", "corrupt", "truncate", "duplicate", "slow", "intermittent", "delayed", "pieces")
_BORNE_OF_SENSORS = (*_BORNE, "reset", "jump")
"""Faults that a bench tolerates, of any device and of sensors: no test has to notice them."""
_HARMFUL_OPTIONS = {"scale": 0.9, "offset_m": 0.1, "rate_rad_s": 0.1}
FOUND = pytest.StashKey["list[BreakageResult]"]()


@dataclass(frozen=True)
class Breakage:
    """One way in which a robot is broken.

    Attributes:
        name: name in tables and on the command line.
        faults: faults of the emulated devices.
        overrides: keys of the bench file -> values.
        matters: True if a robot on a wall may come to harm if the suite does not notice it.
    """

    name: str
    faults: tuple[Fault, ...] = ()
    overrides: Mapping[str, object] = field(default_factory=dict)
    matters: bool = True

    def of(self, source: BenchSource) -> BenchSource:
        """Return the same bench with this broken robot."""
        broken = source.changed(overrides=self.overrides)
        return replace(broken, faults=(*source.faults, *self.faults))


def breakages(source: BenchSource) -> list[Breakage]:
    """Return all faults of a bench's emulated devices, and possible defects of the robot itself."""
    from hil.bench.emulated_devices import supported_faults

    config = source.config
    declared = supported_faults(config)
    return [*_assembled(config), *_weaker(config), *_faulty(declared)]


def _faulty(declared: Mapping[str, Mapping[str, tuple[str, ...]]]) -> Iterator[Breakage]:
    for device in filter(is_tested_itself, declared):
        for kind, options in declared[device].items():
            fault = make_fault(device, kind, at=AT_S)
            yield Breakage(f"{device}:{kind}", (fault,), matters=kind not in _borne(device))
            for option in (o for o in options if kind == "wrong" and o in _HARMFUL_OPTIONS):
                value = _HARMFUL_OPTIONS[option]
                harmful = make_fault(device, kind, at=AT_S, **{option: value})
                yield Breakage(f"{device}:{kind},{option}={value:g}", (harmful,))


def _borne(device: str) -> tuple[str, ...]:
    kind = kinds().get(device)
    return _BORNE if kind is None or kind.moves_robot or kind.holds_robot else _BORNE_OF_SENSORS


def _assembled(config: BenchConfig) -> Iterator[Breakage]:
    """Yield robots that are assembled differently from the bench file."""
    if "servos" in config.emulated():
        yield Breakage("drive FL turns the other way", overrides=_sign(config, "drive"))
        yield Breakage("steering FL turns the other way", overrides=_sign(config, "steer"))
        yield Breakage(
            "steering horn FL one tooth off", (make_fault("servo.steer_FL", "jump", angle_rad=0.25),)
        )
        yield Breakage(
            "wheels three times as far from their drawing", overrides={"emulation.geometry_share": 3.0}
        )
    turned = [0.9659258, 0.0, 0.0, 0.2588190]  # 30 degrees about the normal of the surface
    for kind in ("tracker", "imu"):
        if kind in config.emulated():
            yield Breakage(
                f"{kind} mounted 30 deg off", overrides={f"emulation.{kind}.mount_rotation_wxyz": turned}
            )


def _sign(config: BenchConfig, which: str) -> dict[str, object]:
    first, *others = getattr(config.alignment, f"{which}_sign")
    return {f"alignment.{which}_sign": [-first, *others]}


def _weaker(config: BenchConfig) -> Iterator[Breakage]:
    """Yield robots with reduced force or supply."""
    if config.environment.kind == "wall" and any(kinds()[name].holds_robot for name in config.emulated()):
        yield Breakage(
            "the fan presses half as much", (make_fault("plant", "adhesion_loss", at=1.0, factor=0.5),)
        )
    if "servos" in config.emulated():
        yield Breakage("the battery is nearly empty", overrides={"emulation.servos.supply_v": 8.5})


_CHOSEN = pytest.StashKey[list[Breakage]]()


@dataclass(frozen=True)
class BreakageResult:
    """Result for one broken robot.

    Attributes:
        breakage: the breakage.
        by: name of the test that noticed it; empty for a blind spot.
    """

    breakage: Breakage
    by: str


def check_session(config: pytest.Config) -> None:
    """Raise `pytest.UsageError` for real devices or several processes, with which robots cannot be broken."""
    try:
        source = source_of(config)
        if source.real:
            raise pytest.UsageError(
                f"--hil-blind-spots: {', '.join(source.real)} of bench {source.config.name} are real, and "
                "real robots are not broken on purpose; add --emulate"
            )
        config.stash[_CHOSEN] = _chosen(config)
    except HilError as error:
        raise pytest.UsageError(str(error)) from None
    if in_several_processes(config):
        raise pytest.UsageError("--hil-blind-spots runs in one process; leave -n and --dist out")


def _chosen(config: pytest.Config) -> list[Breakage]:
    pattern, known = config.getoption("hil_blind_spots"), breakages(source_of(config))
    chosen = [b for b in known if fnmatchcase(b.name, pattern)]
    if not chosen:
        names = [b.name for b in known]
        raise pytest.UsageError(
            f"--hil-blind-spots={pattern}: no such breakage; {did_you_mean(pattern, names) or 'one of'} "
            + ", ".join(names)
        )
    return chosen


def run(session: pytest.Session) -> None:
    """Run the suite on the sound robot, then on every broken one; put the results in the session's stash."""
    config = session.config
    seconds = [_sound(session, item, after) for item, after in _pairs(session.items)]
    able = _quick_first(session.items, seconds)
    reporter: TerminalReporter | None = config.pluginmanager.get_plugin("terminalreporter")
    if session.testsfailed or not able:
        session.testsfailed = max(session.testsfailed, 1)
        if reporter is not None:
            reporter.write_line("\non the sound robot the suite has to pass; blind spots were not looked for")
        return
    source = source_of(config)
    session.stash[FOUND] = found = []
    try:
        for breakage in config.stash[_CHOSEN]:
            use_source(config, breakage.of(source))
            found.append(BreakageResult(breakage, _noticed(session, able)))
            if reporter is not None:
                reporter.write("." if found[-1].by else "B" if breakage.matters else "b")
    finally:
        use_source(config, source)
    session.testsfailed += sum(1 for seen in found if not seen.by and seen.breakage.matters)


def _sound(session: pytest.Session, item: pytest.Item, after: pytest.Item | None) -> float | None:
    """Run a test normally; return its duration with fixtures, s, or None if it was skipped."""
    reports = _run(item, after, log=True)
    if session.shouldfail:
        raise session.Failed(session.shouldfail)
    return sum(r.duration for r in reports) if any(r.when == "call" and r.passed for r in reports) else None


def _run(item: pytest.Item, after: pytest.Item | None, *, log: bool) -> list[pytest.TestReport]:
    """Run a test with the rights that its markers give; return its reports."""
    with stand_ins_of(item):
        return runtestprotocol(item, nextitem=after, log=log)


def _quick_first(items: Sequence[pytest.Item], seconds: Sequence[float | None]) -> list[pytest.Item]:
    """Return the tests that ran, quickest module first: tests of a module stay together to share fixtures."""
    modules: dict[object, list[tuple[float, pytest.Item]]] = {}
    for item, duration in zip(items, seconds, strict=True):
        if duration is not None:
            modules.setdefault(item.parent, []).append((duration, item))
    ranked = sorted(modules.values(), key=lambda members: sum(duration for duration, _ in members))
    return [item for members in ranked for _, item in members]


def _pairs(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Yield each test with the next one."""
    return zip(items, [*items[1:], None], strict=True)


def _noticed(session: pytest.Session, items: Sequence[pytest.Item]) -> str:
    """Run tests until one fails; return its name, or an empty text."""
    for item, after in _pairs(items):
        getattr(item, "_initrequest", lambda: None)()  # create the fixtures of the test again
        if any(report.failed for report in _run(item, after, log=False)):
            session._setupstate.teardown_exact(None)
            return item.nodeid
    return ""


def summary(reporter: TerminalReporter, found: Sequence[BreakageResult]) -> None:
    """Print the table: which test noticed each breakage, and which breakages no test noticed."""
    blind = [seen for seen in found if not seen.by and seen.breakage.matters]
    tolerated = [seen for seen in found if not seen.by and not seen.breakage.matters]
    reporter.section("blind spots")
    width = max(len(seen.breakage.name) for seen in found)
    for seen in found:
        if seen.by:
            reporter.write_line(f"{seen.breakage.name:{width}}  {seen.by}")
    for seen in tolerated:
        reporter.write_line(
            f"{seen.breakage.name:{width}}  by no test, and it is of a kind that a bench tolerates"
        )
    for seen in blind:
        reporter.write_line(f"{seen.breakage.name:{width}}  BLIND: no test notices it", red=True)
    reporter.write_line(
        f"{len(found)} broken robots: {len(found) - len(blind) - len(tolerated)} noticed, "
        f"{len(tolerated)} tolerated, {len(blind)} blind spots",
        red=bool(blind),
        green=not blind,
    )
