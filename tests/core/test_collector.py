"""The search for garbage is put off, not given up."""

import gc
import multiprocessing
import sys
import weakref

from hil.vocabulary import collector
from hil.vocabulary.collector import without_collector


class Bench:
    """Refers to itself, as a bench and its parts do, and to what was recorded."""

    def __init__(self):
        self.itself, self.records = self, []


def driven(records):
    bench = Bench()
    with without_collector():
        bench.records = [[k] for k in range(records)]
    return weakref.ref(bench)


def alive_after(benches):
    """How many of them are still there, in a process that keeps little else."""
    before, blocks = sys.getallocatedblocks(), sys.getallocatedblocks
    sys.getallocatedblocks = lambda: blocks() - before
    collector._MANY, collector._kept = 100_000, 0
    made = [driven(30_000) for _ in range(benches)]
    return sum(bench() is not None for bench in made), gc.isenabled()


def test_records_of_one_bench_after_the_other_do_not_pile_up():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        alive, enabled = pool.apply(alive_after, (16,))
    assert alive <= 6
    assert enabled


def test_it_looks_at_nothing_while_records_are_made():
    seen = []
    gc.callbacks.append(lambda phase, info: seen.append(phase))
    try:
        with without_collector():
            made = [[k] for k in range(200_000)]
            meanwhile = list(seen)
    finally:
        gc.callbacks.pop()
    assert len(made) == 200_000
    assert meanwhile == []
