"""Procedures: scripted measurements on a bench, with limits, a verdict and a results folder."""

from typing import TYPE_CHECKING

from hil.support.first_use import on_first_use

if TYPE_CHECKING:
    from hil.procedure.bench_source import BenchSource
    from hil.procedure.context import Context
    from hil.procedure.declaration import PlannedStep, Procedure, procedure
    from hil.procedure.measurements import Measurement, Verdict
else:
    _OFFERED = {
        "BenchSource": "hil.procedure.bench_source",
        "Context": "hil.procedure.context",
        "Measurement": "hil.procedure.measurements",
        "PlannedStep": "hil.procedure.declaration",
        "Procedure": "hil.procedure.declaration",
        "Verdict": "hil.procedure.measurements",
        "procedure": "hil.procedure.declaration",
    }
    __getattr__ = on_first_use(__name__, _OFFERED)

__all__ = ["BenchSource", "Context", "Measurement", "PlannedStep", "Procedure", "Verdict", "procedure"]
