"""What a procedure would do, without moving anything: its steps, its limits, its trajectories checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.bench.loop_settings import geometry_of, motion_limits
from hil.procedure.bench_request import BenchSource
from hil.procedure.declaration import Procedure
from hil.procedure.parameters import as_dict, described, make_parameters
from hil.robot.motion_limits import check


def dry_run(proc: Procedure, source: BenchSource, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Check everything that can be checked beforehand.

    Args:
        proc: the procedure.
        source: bench that it would run on.
        settings: parameters by name.

    Returns:
        JSON values: procedure, parameters, what each of them is (`help`), measurements with limits,
        steps with their trajectories.

    Raises:
        ConfigError, TrajectoryError: the first thing that would go wrong.
    """
    parameters = make_parameters(proc.parameters, settings, proc.name)
    config = source.config
    proc.check_needs(config)
    source.check_faults()
    source.describe_calibration()
    steps = []
    for step in proc.steps(parameters, config):
        for trajectory in step.trajectories:
            check(trajectory, geometry_of(config).projection(), motion_limits(config))
        driven = [{"name": t.name, "duration_s": t.duration_s} for t in step.trajectories]
        steps.append({"title": step.title, "trajectories": driven})
    return {
        "procedure": proc.name,
        "summary": proc.summary,
        "bench": config.name,
        "parameters": as_dict(parameters),
        "help": {d.name: d.help for d in described(proc.parameters) if d.help},
        "measurements": [
            {"name": m.name, "unit": m.unit, "low": m.low, "high": m.high, "rationale": m.rationale}
            for m in proc.declared(parameters, config)
        ],
        "steps": steps,
        "trajectories_checked": sum(len(s["trajectories"]) for s in steps),
    }
