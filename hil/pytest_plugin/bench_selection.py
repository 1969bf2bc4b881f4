"""Selects the bench of a test, skips the test if the bench cannot run it, and fills its report entry."""

from __future__ import annotations

import numbers
import shlex
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hil.config.bench import BenchConfig
from hil.config.several_devices import resolve_device
from hil.core.errors import HilError, UsageError
from hil.core.event_rows import injected_line
from hil.core.registry import kind_of, kinds, which_device
from hil.procedure.bench_source import BenchSource
from hil.pytest_plugin.controllers import driven

if TYPE_CHECKING:
    from hil.bench import Bench, Fault

_SOURCE = pytest.StashKey[BenchSource]()


def source_of(config: pytest.Config) -> BenchSource:
    """Return the session's bench: `--bench` as given, else ini key or shipped profile, all emulated."""
    found = config.stash.get(_SOURCE, None)
    if found is None:
        given = config.getoption("bench")
        base = config.invocation_params.dir if given else config.rootpath
        name = given or config.getini("hil_bench") or "emulated"
        is_file = Path(name).suffix == ".toml" or (base / name).is_file()
        found = config.stash[_SOURCE] = BenchSource(
            base / name if is_file else name,
            emulate=config.getoption("emulate") if given else "all",
            seed=config.getoption("hil_seed"),
            realtime=config.getoption("hil_realtime"),
            inject_real=config.getoption("hil_inject_real"),
        )
    return found


def use_source(config: pytest.Config, source: BenchSource) -> None:
    """Set another bench for tests that begin from now on."""
    config.stash[_SOURCE] = source


def check_session(config: pytest.Config) -> None:
    """Raise `pytest.UsageError` if a bench cannot be read, or cannot be shared by xdist's workers."""
    if hasattr(config, "workerinput"):
        return
    try:
        real = source_of(config).real
    except HilError as error:
        raise pytest.UsageError(str(error)) from None
    if real and in_several_processes(config):
        raise pytest.UsageError(
            f"--bench {config.getoption('bench')}: {', '.join(real)} are real and cannot be shared by "
            "several processes; leave -n and --dist out, or add --emulate"
        )


def refuse_unnamed(config: pytest.Config, given: str | Path | BenchConfig, wanted: BenchConfig) -> None:
    """Reject a bench with real devices that the command line does not name.

    Args:
        config: configuration of the session.
        given: file, profile or configuration with which the bench is requested.
        wanted: the resulting configuration.

    Raises:
        UsageError: a device is real, but not among those that `--bench` and `--emulate` leave real.
    """
    real = [name for name in wanted.devices() if name not in wanted.emulated()]
    if not real:
        return
    found = f"bench {wanted.name if isinstance(given, BenchConfig) else given}: {', '.join(real)} real"
    named = config.getoption("bench")
    if not named:
        raise UsageError(
            f"{found}, and pytest was started without --bench",
            expected="every device emulated where the command line names no bench",
            remedy="start pytest with --bench FILE, or give emulate='all' to open_bench; a test whose ports "
            "are stand-ins is marked opens_stand_ins (docs/pytest.md)",
        )
    source = source_of(config)
    if not _same(given, wanted, source, real):
        raise UsageError(
            f"{found}, and pytest was started with --bench {named}",
            expected=f"real devices of {named} only",
            remedy="name this bench with --bench, or give emulate='all' to open_bench",
        )
    if emulated := [name for name in real if name not in source.real]:
        raise UsageError(
            f"{found}, and --emulate {config.getoption('emulate')} has {', '.join(emulated)} emulated",
            expected=f"only {', '.join(source.real) or 'none'} real",
            remedy="leave --emulate out, or give emulate to open_bench, too",
        )


def _same(
    given: str | Path | BenchConfig, wanted: BenchConfig, source: BenchSource, real: Sequence[str]
) -> bool:
    """Whether a bench is requested by the session's file, or has the same tables for the real devices."""
    if isinstance(given, BenchConfig) or isinstance(source.bench, BenchConfig):
        ours, theirs = source.config.devices(), wanted.devices()
        return all(name in ours and ours[name] == theirs[name] for name in real)
    return Path(given).resolve() == Path(source.bench).resolve()


def in_several_processes(config: pytest.Config) -> bool:
    """Whether xdist runs the tests in several processes (`-n`, or `--dist` with `--tx`)."""
    return config.pluginmanager.has_plugin("dsession")


def describe(config: pytest.Config) -> str:
    """Return one line about the bench for the head of the terminal report."""
    source = source_of(config)
    emulated = ", ".join(source.config.emulated()) or "none"
    real = ", ".join(source.real) or "none"
    return f"hil: bench {source.config.name}, seed {source.seed}; emulated: {emulated}; real: {real}"


def properties(source: BenchSource) -> list[tuple[str, object]]:
    """Return properties of a test case for JUnit XML, named as in the reports of procedures."""
    calibration = source.describe_calibration()
    return [
        ("bench", source.config.name),
        ("calibration_version", "none" if calibration is None else calibration["version"]),
        ("seed", source.seed),
        ("emulated", ",".join(source.config.emulated()) or "none"),
        *(("fault", str(fault)) for fault in source.faults),
        *((("controller", source.controller),) if source.controller else ()),
    ]


def properties_of(bench: Bench) -> list[tuple[str, object]]:
    """Return the same for a bench that a test opened itself; if it is closed, also how it left the robot."""
    version = bench.calibration.rpartition(" version ")[2].partition(" ")[0]
    return [
        ("bench", bench.config.name),
        ("calibration_version", version or "none"),
        ("seed", bench.seed),
        ("emulated", ",".join(bench.config.emulated()) or "none"),
        *(("fault", str(fault)) for fault in bench.faults),
        *([] if bench.is_open else [*injected(bench), *([("held", bench.held.state)] * bench.held.opened)]),
    ]


def injected(bench: Bench) -> list[tuple[str, object]]:
    """Return a property for each fault of a closed bench: where it was injected, when, what it has hit."""
    from hil.bench.injection import with_chips

    found = with_chips(bench.injection.report(), bench.faults, bench.world_ns)
    return [("injected", injected_line(row)) for row in found]


def skip_where_impossible(item: pytest.Item) -> None:
    """Skip a test, with the reason, if the bench of the session cannot run it.

    Raises:
        pytest.fail.Exception: a marker is wrong.
    """
    with plainly():
        _must_have_bench(item)
        source = source_of(item.config)
        reason = _impossible(item, source)
        if reason:
            item.user_properties.extend(properties(source))
            item.add_marker(pytest.mark.skip(reason=reason), append=False)


def _must_have_bench(item: pytest.Item) -> None:
    """Reject faults of a test without the fixture `bench`: nothing would apply them."""
    faults = faults_of(item)
    if "bench" in getattr(item, "fixturenames", ()):
        return
    if mark := item.get_closest_marker("controller"):
        raise UsageError(
            f"marker {_written(mark)}: the test does not use the fixture `bench`, and the marker acts "
            "through it only"
        )
    if faults:
        raise UsageError(
            f"marker fault for {', '.join(map(str, faults))}: the test does not use the fixture `bench`, "
            "and the marker acts through it only",
            expected="`bench` (or `world`, `clock`, `loop`) among the test's arguments",
            remedy="a bench of hil.open_bench takes faults=[...]",
        )


def _impossible(item: pytest.Item, source: BenchSource) -> str:
    config = source.config
    devices, emulated, labels = config.devices(), config.emulated(), config.labels()
    needed = tuple(resolve_device(name, labels) for name in _needed(item))
    missing = [name for name in needed if name not in devices]
    if missing:
        return f"needs {', '.join(missing)}, which bench {config.name} lacks"
    if item.get_closest_marker("real_only"):
        fake = [name for name in (needed or devices) if name in emulated]
        if fake:
            return f"real_only: bench {config.name} emulates {', '.join(fake)}"
    for fault in faults_of(item):
        device = resolve_device(_device(fault.device.partition(".")[0]), labels)
        message = f"fault {fault.device}:{fault.kind}: "
        if device in kinds() and device not in devices:
            return f"{message}bench {config.name} lacks {device}"
        if (device in source.real or not emulated) and not source.inject_real:
            return f"{message}{device} of bench {config.name} is real (--hil-inject-real injects it)"
    return ""


@contextmanager
def opened(item: pytest.Item) -> Generator[Bench, None, None]:
    """Open the bench for one test, with the faults of its markers; add its name to the test's report."""
    with ExitStack() as stack:
        with plainly():
            source = source_of(item.config)
            source = driven(item, replace(source, faults=(*source.faults, *faults_of(item))))
            item.user_properties.extend(properties(source))
            bench = source.open()
            bench.warns_not_held = False
            stack.enter_context(bench)
        yield bench


def how_to_repeat(item: pytest.Item, bench: Bench) -> str:
    """Return what is needed to repeat a failure: bench, faults, time and command line."""
    config, options = item.config, [f"--hil-seed={bench.seed}"]
    for option, name in (("--bench", "bench"), ("--emulate", "emulate")):
        if given := config.getoption(name):
            options.append(f"{option}={given}")
    for option, name in (("--hil-realtime", "hil_realtime"), ("--hil-inject-real", "hil_inject_real")):
        if config.getoption(name):
            options.append(option)
    for given in config.getoption("override_ini") or ():
        if given.partition("=")[0].strip() == "hil_bench":
            options += ["-o", given]
    faults = "".join(f", fault {fault}" for fault in faults_of(item))
    if mark := item.get_closest_marker("controller"):
        faults += f", controller {mark.args[0]}"
    return (
        f"bench {bench.config.name}{faults}, at {bench.clock.now_ns() * 1e-9:.3f} s of its clock\n"
        f"repeat with {shlex.join(options)}"
    )


def _device(name: str) -> str:
    kind = kind_of(name)
    return name if kind is None else kind.name


def _needed(item: pytest.Item) -> tuple[str, ...]:
    marks = list(item.iter_markers("needs"))
    if empty := [mark for mark in marks if not mark.args or mark.kwargs]:
        raise UsageError(f"marker {_written(empty[0])}", expected='needs("kind of device", ...)')
    names = [_device(str(n)) for mark in marks for n in mark.args]
    for name in names:
        if name not in kinds():
            raise UsageError(
                f"marker needs({name!r})",
                expected="some of " + ", ".join(kinds()),
                remedy=which_device(name, kinds())
                or "install the package that adds this kind of device, or correct the name",
            )
    return tuple(dict.fromkeys(names))


def faults_of(item: pytest.Item) -> tuple[Fault, ...]:
    """Return the faults of all markers of a test, the outermost first."""
    return tuple(_fault(mark) for mark in reversed(list(item.iter_markers("fault"))))


def _fault(mark: pytest.Mark) -> Fault:
    from hil.bench import check_fault_kind, make_fault

    texts = [a for a in mark.args if isinstance(a, str)]
    wrong = [
        f"{k}={v!r}" for k, v in mark.kwargs.items() if not _is_number(v) and (k, v) != ("duration", None)
    ]
    if len(texts) != 2 or len(mark.args) != 2 or wrong:
        message = (
            f"{', '.join(wrong)} of the marker {_written(mark)}" if wrong else f"marker {_written(mark)}"
        )
        raise UsageError(
            message, expected='fault("device", "kind", at=seconds, duration=seconds, option=number)'
        )
    device, kind = texts
    check_fault_kind(f"marker {_written(mark)}: {kind!r} is no kind of fault", kind)
    given: dict[str, Any] = {
        key: None if value is None else float(value) for key, value in mark.kwargs.items()
    }
    return make_fault(_device(device), kind, **given)


def _is_number(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def _written(mark: pytest.Mark) -> str:
    """Return a marker as text, as its author wrote it."""
    given = [*map(repr, mark.args), *(f"{key}={value!r}" for key, value in mark.kwargs.items())]
    return f"{mark.name}({', '.join(given)})"


@contextmanager
def plainly() -> Generator[None, None, None]:
    """Report this package's errors as one line: a traceback through the bench does not help a test author."""
    try:
        yield
    except HilError as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None
