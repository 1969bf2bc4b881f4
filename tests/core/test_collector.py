"""The search for garbage is put off, not given up."""

import gc
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


def test_records_of_one_bench_after_the_other_do_not_pile_up(monkeypatch):
    monkeypatch.setattr(collector, "_MANY", 10_000)
    monkeypatch.setattr(collector, "_kept", len(gc.get_objects()))
    one = len(gc.get_objects()) // 2
    benches = [driven(one) for _ in range(8)]
    assert sum(bench() is not None for bench in benches) <= 4
    assert gc.isenabled()


def test_it_looks_at_nothing_while_records_are_made():
    seen = []
    gc.callbacks.append(lambda phase, info: seen.append(phase))
    try:
        with without_collector():
            made = [[k] for k in range(20_000)]
    finally:
        gc.callbacks.pop()
    assert len(made) == 20_000
    assert seen == []
