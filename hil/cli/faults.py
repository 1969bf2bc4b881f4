"""`hil faults`: every fault of every device, judged: is the robot held, is the cause named."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.completion_types import FAULT
from hil.cli.fault_request import DEFAULTS, Asked, cells_at_links, on_devices
from hil.cli.interrupted_series import shown_when_ended
from hil.cli.options import JSON, OUT
from hil.cli.progress import reporting
from hil.core.errors import EXIT_LIMIT_FAILED, EXIT_PASS, UsageError, did_you_mean, shown_path
from hil.core.result_names import FAULTS_MATRIX, FAULTS_PAGE
from hil.support.atomic_files import check_file
from hil.support.folder_lock import locked

if TYPE_CHECKING:
    from hil.fault_matrix import Cell, CellVerdict, KeptVerdicts


@click.command()
@click.option(
    "--configuration",
    is_flag=True,
    help="Instead: wrong numbers in the bench file, with hardware that has the true ones.",
)
@click.option("--quick", is_flag=True, help="A handful of cells: one of each way to lose a robot.")
@click.option("--seeds", default="0:1", show_default=True, help="Seeds of the worlds: 0:5, or 1,4,7.")
@click.option(
    "--only", multiple=True, type=FAULT, metavar="DEVICE[:FAULT[@MOMENT]]", help="Only these (repeatable)."
)
@click.option("--moments", default=DEFAULTS["moments"], show_default=True, help="When, by commas.")
@click.option(
    "--plants", default=DEFAULTS["plants"], show_default=True, help="Physics, by commas: own, mujoco."
)
@click.option(
    "--random",
    "count",
    type=click.IntRange(1, 100_000),
    help="Instead: this many runs with one to four faults at random moments.",
)
@bench_options("bench", "inject_real", bench={"default": DEFAULTS["bench"]})
@click.option(
    "--workers",
    type=click.IntRange(0, 1000),
    default=0,
    show_default=True,
    help="Processes (needs the extra `campaign`); 0 runs here.",
)
@click.option("--out", type=OUT, default=Path("out/faults"), show_default=True, help="Folder of the pages.")
@click.option(
    "--resume",
    is_flag=True,
    help="Go on with the cells that are missing in --out: the same command once more.",
)
@JSON
def command(
    configuration: bool,
    quick: bool,
    seeds: str,
    only: tuple[str, ...],
    moments: str,
    plants: str,
    count: int | None,
    request: BenchRequest,
    workers: int,
    out: Path,
    resume: bool,
    as_json: bool,
) -> int:
    """Every fault of every emulated device, at four moments of a climb, judged, on one page.

    With --inject-real: those faults of real devices that [faults] of the bench file permits, one after the
    other, in real time, on the floor or on a tether. The robot drives 12 cm and returns for each.

    With --configuration: one wrong number in the bench file after another (pole pairs of another motor, a
    mount turned by 90 degrees, left for right). Doctor, bring_up or a short climb have to name its key; where
    one that has an effect stays silent, it ends with 1. --only takes a key, or a table.

    Example: hil faults --quick
    """
    if configuration:
        asked = Asked(quick, seeds, only, moments, plants, count, request.bench)
        return _configuration(asked, workers, out, resume, as_json)
    from hil.fault_matrix import KeptVerdicts, missing, run_cell, summary, write_faults, write_page

    began = datetime.now(timezone.utc).isoformat(timespec="seconds")
    bench = request.bench
    asked = Asked(quick, seeds, only, moments, plants, count, bench, request.inject_real)
    cells = _cells(asked)
    check_file(out / FAULTS_PAGE)
    check_file(out / FAULTS_MATRIX)
    out.mkdir(parents=True, exist_ok=True)
    where = os.path.abspath(bench) if os.path.isfile(bench) else bench
    with locked(out, "a fault campaign"), KeptVerdicts(out, where, resume=resume) as kept:
        there = {verdict.cell: verdict for verdict in kept.there}
        if others := len(there.keys() - set(cells)):
            raise UsageError(
                f"--resume: {others} cells in {shown_path(out)} are none of those that are asked for",
                expected="the options of the command that began there",
                remedy="give that command with --resume, or another --out",
            )

        def judged() -> list[CellVerdict]:
            return [there[cell] for cell in cells if cell in there]

        def write() -> Path:
            reported = summary(judged(), bench=bench, command=_shown(asked), planned=len(cells))
            write_page(out / FAULTS_MATRIX, reported)
            return write_faults(out, {**reported, "began": began})

        def finished() -> str:
            return f"{len(judged())} of {len(cells)} cells are judged"

        with shown_when_ended(finished, lambda: shown_path(write()) if judged() else ""):
            run = on_devices(asked, where, workers) if asked.inject_real else partial(run_cell, bench=where)
            _judge(missing(cells, kept.there), there, run, workers, kept)
    verdicts, page = judged(), write()
    failed = [v for v in verdicts if v.why]
    if as_json:
        click.echo(json.dumps(_json(verdicts, out / FAULTS_MATRIX, page), allow_nan=False))
    else:
        click.echo(f"{len(verdicts)} cells, {len(failed)} failed; page: {shown_path(page)}")
    return EXIT_LIMIT_FAILED if failed else EXIT_PASS


def _configuration(asked: Asked, workers: int, out: Path, resume: bool, as_json: bool) -> int:
    """Run the campaign of wrong values; by default on both physics, in its short form on one."""
    from hil.campaign import parse_seeds
    from hil.cli.wrong_values import refuse_others, run_wrong_values
    from hil.fault_matrix import PLANTS

    refuse_others(
        {
            "--moments": asked.moments != DEFAULTS["moments"],
            "--random": asked.count is not None,
            "--bench": asked.bench != DEFAULTS["bench"],
            "--resume": resume,
        }
    )
    context = click.get_current_context()
    chosen = context.get_parameter_source("plants") is not ParameterSource.DEFAULT
    return run_wrong_values(
        plants=_known("--plants", asked.plants, PLANTS) if chosen or asked.quick else PLANTS,
        seeds=parse_seeds(asked.seeds),
        quick=asked.quick,
        only=asked.only,
        workers=workers,
        out=out,
        as_json=as_json,
    )


def _judge(
    cells: Sequence[Cell],
    there: dict[Cell, CellVerdict],
    run: Callable[[Cell], CellVerdict],
    workers: int,
    kept: KeptVerdicts,
) -> None:
    """Run these cells, report progress, and store every verdict at once, also in `there`."""
    from hil.campaign import spread
    from hil.fault_matrix import lost

    count = 0
    with reporting() as report:

        def done(verdict: CellVerdict) -> None:
            nonlocal count
            there[verdict.cell], count = verdict, count + 1
            kept.add(verdict)
            if verdict.why:
                click.echo(f"FAILED {verdict.cell.name}: {'; '.join(verdict.why)}", err=True)
                for line in verdict.told:
                    click.echo(f"  told: {line}", err=True)
            report("cells", count, len(cells))

        spread(run, cells, lost=lost, done=done, workers=workers)


def _cells(asked: Asked) -> tuple[Cell, ...]:
    """The selected cells; raises `UsageError` for an unknown name or a bench with real devices."""
    from hil.bench import check_faults, supported_faults
    from hil.campaign import parse_seeds
    from hil.config.loading import load_bench
    from hil.fault_matrix import MOMENTS, PLANTS, cells_of, quick_cells, random_cells

    worlds = parse_seeds(asked.seeds)
    moments = _known("--moments", asked.moments, tuple(MOMENTS))
    physics = _known("--plants", asked.plants, PLANTS)
    if sum((asked.quick, bool(asked.only), asked.count is not None)) > 1:
        raise UsageError("--quick, --only and --random exclude each other", expected="one of them")
    config = load_bench(asked.bench)
    if asked.inject_real:
        return cells_at_links(asked, config, worlds, moments)
    if real := [name for name in config.devices() if name not in config.emulated()]:
        raise UsageError(
            f"bench {config.name}: {', '.join(real)} cannot be real in a fault campaign",
            expected="every device emulated",
            remedy="use --bench emulated; --inject-real injects at the links of real devices",
        )
    for plant in physics:
        check_faults(load_bench(config, overrides={"emulation.plant": plant}), ())
    supported = supported_faults(config)
    if asked.quick:
        return quick_cells(supported, seeds=worlds, plants=physics)
    if asked.count is not None:
        return random_cells(supported, count=asked.count, seeds=worlds, plants=physics)
    return cells_of(supported, seeds=worlds, plants=physics, moments=moments, only=asked.only)


def _known(option: str, text: str, names: Sequence[str]) -> tuple[str, ...]:
    """Names of a comma-separated option; raises `UsageError` for one that is not in `names`."""
    given = tuple(text.split(","))
    for name in given:
        if name not in names:
            raise UsageError(
                f"{option} {name!r} is unknown",
                expected="of " + ", ".join(names),
                remedy=did_you_mean(name, names),
            )
    return given


def _shown(asked: Asked) -> str:
    """The command line that repeats this fault campaign."""
    parts = ["hil faults", f"--seeds {asked.seeds}"]
    parts += ["--quick"] if asked.quick else [f"--only {text}" for text in asked.only]
    parts += ["--inject-real"] * asked.inject_real
    for option, given in (("moments", asked.moments), ("plants", asked.plants), ("bench", asked.bench)):
        parts += [f"--{option} {given}"] if given != DEFAULTS[option] else []
    return " ".join([*parts, *([f"--random {asked.count}"] if asked.count is not None else [])])


def _json(verdicts: Sequence[CellVerdict], table: Path, page: Path) -> dict[str, object]:
    from hil.fault_matrix import told_rows

    return {
        "cells": len(verdicts),
        "failed": [
            {
                "device": v.cell.device,
                "fault": v.cell.fault,
                "moment": v.cell.moment,
                "seed": v.cell.seed,
                "plant": v.cell.plant,
                "specs": list(v.cell.specs),
                "why": "; ".join(v.why),
                "told": list(v.told),
            }
            for v in verdicts
            if v.why
        ],
        "told": told_rows(verdicts),
        "quiet": [v.cell.name for v in verdicts if not v.reported and not v.why],
        "table": str(table),
        "page": str(page),
    }
