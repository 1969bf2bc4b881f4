"""A bench ready to use: configuration, devices, clock and loop combined.

Only this package and `hil.devkit` import drivers and fakes; other packages use them through this one. `with
open_bench("emulated") as bench:` gives a script the same devices, clock and loop as the command line and the
procedures.
"""

from typing import TYPE_CHECKING

from hil.support.first_use import on_first_use

if TYPE_CHECKING:
    from hil.bench.bench import Bench
    from hil.bench.emulated_devices import (
        check_faults,
        faults_within,
        hidden_truth,
        open_emulation,
        planned_faults,
        supported_faults,
    )
    from hil.bench.hold.held_state import Held
    from hil.bench.injection import check_travel
    from hil.bench.loop_settings import alignment_parameters, safety_limits
    from hil.bench.opening import make_bench_model, open_bench
    from hil.drivers.servos.dynamixel.commissioning import set_up
    from hil.fakes.world import World
    from hil.faults.fault import Fault, make_fault
    from hil.faults.fault import check_kind as check_fault_kind
else:
    _OFFERED = {
        "Bench": "hil.bench.bench",
        "Fault": "hil.faults.fault",
        "Held": "hil.bench.hold.held_state",
        "World": "hil.fakes.world",
        "alignment_parameters": "hil.bench.loop_settings",
        "check_fault_kind": "hil.faults.fault:check_kind",
        "check_faults": "hil.bench.emulated_devices",
        "check_travel": "hil.bench.injection",
        "faults_within": "hil.bench.emulated_devices",
        "hidden_truth": "hil.bench.emulated_devices",
        "make_bench_model": "hil.bench.opening",
        "make_fault": "hil.faults.fault",
        "open_bench": "hil.bench.opening",
        "open_emulation": "hil.bench.emulated_devices",
        "planned_faults": "hil.bench.emulated_devices",
        "safety_limits": "hil.bench.loop_settings",
        "set_up": "hil.drivers.servos.dynamixel.commissioning",
        "supported_faults": "hil.bench.emulated_devices",
    }
    __getattr__ = on_first_use(__name__, _OFFERED)

__all__ = [
    "Bench",
    "Fault",
    "Held",
    "World",
    "alignment_parameters",
    "check_fault_kind",
    "check_faults",
    "check_travel",
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
