"""Small procedures that need no bench, and a way to run them."""

import itertools

import pytest

from hil.config.bench import BenchConfig
from hil.core.clock import MonotonicClock
from hil.procedure.bench_source import BenchSource
from hil.procedure.runner import RunOptions, run_procedure


class Scripted:
    """An operator who says the same each time and remembers what was asked."""

    def __init__(self, answer="yes"):
        self.answer, self.asked = answer, []

    def ask(self, question):
        self.asked.append(question)
        return self.answer


@pytest.fixture(scope="module", autouse=True)
def without_topics(cycles_alone):
    """No test here reads the topics of a recording."""


@pytest.fixture
def bare_source():
    return BenchSource(BenchConfig(schema=1, name="bare"))


@pytest.fixture
def run_small(tmp_path, bare_source):
    numbers = itertools.count(1)

    def run(proc, folder=None, *, source=None, parameters=None, **options):
        chosen = folder if folder is not None else tmp_path / f"run{next(numbers)}"
        filled = {"operator": Scripted(), **options}
        return run_procedure(
            proc,
            source or bare_source,
            RunOptions(chosen, MonotonicClock(), "2026-01-01T00:00:00", parameters or {}, **filled),
        )

    return run
