"""A bench ready to use: configuration, devices, clock and loop combined.

Only this package and `hil.devices` import drivers and fakes; other packages use them through this one. `with
open_bench("emulated") as bench:` gives a script the same devices, clock and loop as the command line and the
procedures.
"""

from hil.bench.bench import Bench
from hil.bench.emulation import (
    check_faults,
    faults_within,
    hidden_truth,
    open_emulation,
    planned_faults,
    supported_faults,
)
from hil.bench.hold.result import Held
from hil.bench.loop_settings import alignment_parameters, safety_limits
from hil.bench.opening import make_bench_model, open_bench
from hil.drivers.servos import set_up
from hil.fakes.world import World
from hil.faults.fault import Fault, make_fault
from hil.faults.fault import check_kind as check_fault_kind
from hil.faults.fault import describe as describe_fault

__all__ = [
    "Bench",
    "Fault",
    "Held",
    "World",
    "alignment_parameters",
    "check_fault_kind",
    "check_faults",
    "describe_fault",
    "faults_within",
    "hidden_truth",
    "make_bench_model",
    "make_fault",
    "open_bench",
    "open_emulation",
    "planned_faults",
    "safety_limits",
    "set_up",
    "supported_faults",
]
