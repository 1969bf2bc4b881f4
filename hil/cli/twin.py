"""`hil twin`: how far recordings of a robot and the emulated robot are apart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.completion_types import BENCH
from hil.cli.nominal_robot_option import on_paper
from hil.cli.options import FILE, JSON, SEED, TOPICS, SuggestingGroup
from hil.cli.progress import reporting
from hil.core.errors import EXIT_LIMIT_FAILED, EXIT_PASS

if TYPE_CHECKING:
    from hil.twin.compare import Comparison

_MARKS = {True: "", False: "  told apart", None: "  no control"}


@click.group(cls=SuggestingGroup)
def command() -> None:
    """The emulated robot beside recordings of a real one."""


@command.command()
@click.argument("recordings", nargs=-1, required=True)
@click.option(
    "--bench",
    type=BENCH,
    default="emulated_floor",
    show_default=True,
    help="Bench file or profile whose [emulation] is compared.",
)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of the first emulated run.")
@TOPICS
@click.option("--page", type=FILE, help="Write an HTML page, too.")
@JSON
def compare(
    recordings: tuple[str, ...], bench: str, seed: int, topics: Path | None, page: Path | None, as_json: bool
) -> int:
    """Drive the emulated robot with the commands of recordings, and compare what both measure.

    Figures: the end error of nominal odometry, with the interval in which 90 % of emulated runs lie. Signals:
    how well a classifier tells recorded from emulated stretches on motions that it has not seen (AUC: 0.5 is
    chance), and, as a control, repetitions of the recorded robot against each other. The exit code is 1 if a
    figure lies outside its interval, or an AUC is above 0.7 where the control is at most 0.6.

    Example: hil twin compare recordings/ --page twin.html
    """
    from hil.config.loading import load_bench
    from hil.datasets.read import read_recordings
    from hil.support.atomic_files import check_ending
    from hil.twin.compare import compare as compare_runs
    from hil.twin.page import sentence, write_twin_page

    if page is not None:
        check_ending(page, ".html")
    config = load_bench(bench, seed=seed)
    with reporting() as report:
        found = read_recordings(
            recordings,
            lambda done, total: report("reading", done, total),
            topics=topics,
            nominal=on_paper(config),
        )
        for line in (text for one in found for text in one.warnings()):
            click.echo(f"warning: {line}", err=True)
        result = compare_runs(found, config, seed, report)
    if page is not None:
        write_twin_page(page, f"Recorded and emulated: {config.name}", result)
        click.echo(f"page: {page}", err=True)
    if as_json:
        click.echo(json.dumps({"bench": config.name, "recordings": len(found), **result.to_json()}))
    else:
        click.echo(f"{sentence(result)}\n{_text(result)}")
    return EXIT_PASS if result.passed else EXIT_LIMIT_FAILED


def _text(found: Comparison) -> str:
    lines = [f"{'signals':16}{'AUC':>8}{'control':>9}"]
    lines += [f"{s.group:16}{s.auc:8.2f}{s.control:9.2f}{_MARKS[s.alike]}" for s in found.signals]
    lines.append(f"{'end error of':16}{'':10}{'recorded':>10}{'least':>10}{'most':>10}")
    for f in found.figures:
        outside = "" if f.inside else "  outside"
        name = f"{f.name} {f.unit}"
        lines.append(f"{f.motion:14}{name:12}{f.recorded:10.2f}{f.low:10.2f}{f.high:10.2f}{outside}")
    return "\n".join(lines)
