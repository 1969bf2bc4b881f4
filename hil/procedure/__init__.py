"""Procedures: scripted measurements on a bench, with limits, a verdict and a results folder."""

from hil.procedure.bench_request import BenchSource
from hil.procedure.context import Context
from hil.procedure.declaration import PlannedStep, Procedure, procedure
from hil.procedure.measurements import Measurement, Verdict

__all__ = ["BenchSource", "Context", "Measurement", "PlannedStep", "Procedure", "Verdict", "procedure"]
