"""The contract suite finds a fault that a device declares and that changes nothing."""

import pytest

from hil.bench.contract import Broken, Subject
from hil.bench.contract.fault_effects import each_fault_acts
from hil.procedure.bench_source import BenchSource

IDLE = "adhesion_loss"
"""No IMU does anything at it."""


def subject_of(kind, *extra, healthy_differs=False):
    seeds = iter(range(100))

    def anew():
        bench = BenchSource("emulated_floor", seed=next(seeds) if healthy_differs else 0).open()
        faults = bench.world.faults
        kept = {k: v for k, v in faults.supported[kind].items() if k in ("stuck", "baud_mismatch")}
        faults.declare(kind, {**kept, **dict.fromkeys(extra, ())})
        return bench

    bench = anew()
    bench.begin()
    return Subject(bench, kind, anew)


def test_a_fault_that_does_nothing_is_named_and_no_other():
    with pytest.raises(Broken, match=f"imu declares {IDLE}, and nothing changes"):
        each_fault_acts(subject_of("imu", IDLE))


def test_faults_that_act_pass():
    assert each_fault_acts(subject_of("imu")).startswith("2 faults")


def test_nothing_is_said_of_faults_where_two_healthy_runs_differ():
    with pytest.raises(Broken, match="without a fault differ"):
        each_fault_acts(subject_of("imu", IDLE, healthy_differs=True))
