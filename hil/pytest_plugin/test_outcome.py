"""Checks after a test that its robot is held, and that the faults of its markers have acted.

An emulated robot may be lost on purpose, a real one never. So a robot without the hold it should have is an
error of the test if a device is real, and at wire level if no test requested faults. In virtual time it is a
warning; with faults it is only listed in the summary, in the report of the test and in JUnit XML.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from hil.bench.injection import nothing_hit
from hil.core.errors import UsageError
from hil.pytest_plugin import NOT_HELD, NotHeldWarning
from hil.pytest_plugin.bench_selection import faults_of, source_of

if TYPE_CHECKING:
    from hil.bench import Bench


def end(item: pytest.Item, bench: Bench, *, passed: bool) -> None:
    """Report how a test has left its bench, which is closed.

    Args:
        item: the test.
        bench: its bench.
        passed: True if the test itself has passed.

    Raises:
        pytest.fail.Exception: the robot lost its hold and must not, or a test passed without its faults.
    """
    problems = [*_not_held(item, bench), *(_vacuous(item, bench) if passed else ())]
    if problems:
        raise pytest.fail.Exception("\n".join(problems), pytrace=False)


def _not_held(item: pytest.Item, bench: Bench) -> list[str]:
    held = bench.held
    if not held.opened:
        return []
    item.user_properties.append(("held", held.state))
    if not held.lost:
        return []
    item.user_properties.append((NOT_HELD, str(held)))
    item.add_report_section("teardown", "bench", str(held))
    text = f"bench {bench.config.name}: the test has left the robot {held}"
    source = source_of(item.config)
    if source.real or (bench.world is None and not bench.faults):
        return [text]
    on_purpose = item.config.getoption("hil_blind_spots")
    if bench.world is not None and not bench.world.faults.touched and not on_purpose:
        try:
            item.warn(NotHeldWarning(text))
        except NotHeldWarning:  # warnings are errors here
            return [text]
    return []


def _vacuous(item: pytest.Item, bench: Bench) -> list[str]:
    own = faults_of(item)
    missed = [fault for fault in bench.faults_not_met() if fault in own]
    if idle := [fault for fault in bench.faults_without_effect() if fault in own]:
        return [f"the test has passed without what it is about: {nothing_hit(idle)}"]
    if not missed:
        return []
    error = UsageError(
        f"the test has passed without what it is about: {bench.not_met_in_words(missed)}",
        expected="a time `at` within the test, in seconds since the world began",
        remedy="let it act while the test drives or observes",
    )
    return [str(error)]
