"""A fault in front of a real device that has hit no message: an error of its own, or beside another one."""

from dataclasses import dataclass

import pytest

from hil.core.errors import DeviceError
from hil.procedure import procedure
from hil.procedure.bench_source import BenchSource
from tests.bench.test_injection import bench_with

RARE = "tracker:drop@1+0.5,probability=1e-6"


@dataclass(frozen=True)
class AtLinks(BenchSource):
    """A bench whose emulated devices have the faults at their links, as real ones do."""

    def open(self, sinks=()):
        bench = bench_with(RARE, "imu:silent@1+0.5", profile="emulated_floor")
        for sink in sinks:
            bench.add_sink(sink)
        return bench


@procedure(name="watches", measurements=())
def watches(ctx):
    """Watches for 2.5 s."""
    with ctx.step("watch"):
        ctx.bench.observe(2.5)


@procedure(name="fails", measurements=())
def fails(ctx):
    """Watches for 2.5 s, and fails."""
    watches.body(ctx)
    raise DeviceError("scales", "the scales are gone")


@pytest.mark.parametrize(("proc", "kind"), [(watches, "FaultWithoutEffect"), (fails, "DeviceError")])
def test_it_is_named_whatever_ended_the_run(run_small, proc, kind):
    result = run_small(proc, source=AtLinks("emulated_floor"))
    error = result.error or result.teardown_errors[0]
    assert error.kind == kind
    assert result.exit_code != 0
    told = [note for note in [*result.facts["notes"], error.message] if RARE.split(",")[0] in note]
    assert len(told) == 1
    assert not any("imu:silent" in note for note in result.facts["notes"])
