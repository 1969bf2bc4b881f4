"""Robot that a command on recordings is about: `--bench FILE`, else the CAD model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hil.cli.completion_types import BENCH as BENCH_FILE

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig
    from hil.datasets.nominal_robot import Nominal

BENCH = click.option(
    "--bench",
    type=BENCH_FILE,
    help="Bench file or profile of the robot: its wheels, loads and steering range [default: CAD geometry].",
)


def configured(bench: str | None) -> BenchConfig | None:
    """The configuration of a bench file or profile, None without one."""
    from hil.config.loading import load_bench

    return None if bench is None else load_bench(bench)


def on_paper(config: BenchConfig | None) -> Nominal:
    """The nominal robot of a bench, before any calibration; the CAD model without a bench."""
    from hil.datasets.nominal_robot import Nominal

    if config is None:
        return Nominal()
    from hil.bench.loop_settings import nominal_of

    return nominal_of(config)
