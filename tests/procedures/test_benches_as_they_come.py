"""The first procedure runs on a bench of which nothing is known yet, not even the encoders' zeros."""

import numpy as np
import pytest

from hil.bench import open_bench
from hil.procedure import BenchSource
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import dry_run
from hil.procedure.sample_arrays import encoders


def test_encoders_whose_zeros_are_unknown_are_read_as_they_are():
    with open_bench("emulated_delivered") as bench:
        assert bench.config.encoders.zero_rad is None
        motion = bench.observe(0.1, feedback="odometry")
        read = encoders(motion, bench.config)
    raw = [s.angle_rad for r in motion.records for s in r.inputs.encoders]
    assert np.allclose(read.values, raw[: len(read.values)])


@pytest.mark.parametrize("name", ["bring_up", "latency"])
def test_the_devices_that_a_run_looks_at_are_those_of_its_bench(name):
    proc = load_procedure(name)
    without = BenchSource("emulated_floor", overrides={"encoders": None})
    every = dry_run(proc, BenchSource("emulated_floor"), {})["parameters"]["devices"]
    own = dry_run(proc, without, {})["parameters"]["devices"]
    assert own
    assert set(every) - set(own) == {"encoders"}
    named = dry_run(proc, BenchSource("emulated_floor"), {"devices": own})["parameters"]["devices"]
    assert named == own
