"""`hil doctor`: checks every device of a bench, and says how to repair what fails."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.bench_options import BenchRequest, bench_options
from hil.cli.closed_output import print_user_calls
from hil.cli.options import JSON, OUT, FiniteRange
from hil.core.errors import EXIT_DEVICE, EXIT_PASS

if TYPE_CHECKING:
    from hil.core.cross_check import CrossCheck

_MARKS = {"ok": ("ok", "green"), "warning": ("warn", "yellow"), "failure": ("FAIL", "red")}

_STATES = {"confirmed": "green", "unconfirmed": "yellow", "contradicted": "red"}
_LEAST_WATCH_S = 0.1
"""Shortest watch time: within less, a slow device may send nothing although it works."""


@click.command()
@bench_options("bench", "emulate", "realtime", "seed", "faults")
@click.option(
    "--watch",
    "watch_s",
    type=FiniteRange(_LEAST_WATCH_S, 3600.0),
    default=2.0,
    show_default=True,
    help="Seconds that each device is read.",
)
@click.option("--fix", is_flag=True, help="Print udev rules for the bench's adapters instead.")
@click.option("--out", type=OUT, help="With --fix: file to write them to.")
@JSON
def command(request: BenchRequest, watch_s: float, fix: bool, out: Path | None, as_json: bool) -> int:
    """Examine every device of a bench without moving it.

    At the end it lists the numbers of the bench file that scale a result or a safety figure: confirmed by a
    measurement, contradicted, or unconfirmed.

    Ends with 0 when nothing failed (warnings are allowed), else with 3; with 2 where the bench has no device.
    --fix opens no device: it prints udev rules for the adapters that are plugged in (latency timer, access,
    no suspend, no ModemManager).

    Example: hil doctor --bench my.toml
    """
    from itertools import chain

    from hil.bench.doctor.degraded_bench import open_degraded
    from hil.bench.doctor.examination import examine
    from hil.config.loading import must_have_a_device

    if fix or out is not None:
        return _fix(request, fix, out)
    findings = []
    opened, left_out = open_degraded(
        request.bench,
        emulate=request.emulate,
        realtime=request.realtime,
        seed=request.seed,
        faults=request.faults,
    )
    if not left_out:
        must_have_a_device(opened.config, request.bench, "nothing was examined")
    width = max((9, *map(len, opened.config.devices()), *(len(f.device) for f in left_out)))
    for finding in chain(left_out, examine(opened, watch_s=watch_s)):
        findings.append(finding)
        if not as_json:
            mark, colour = _MARKS[finding.level]
            click.echo(
                f"{click.style(f'{mark:4}', fg=colour)} {finding.device:{width}} {finding.check}: "
                f"{finding.found}"
            )
            if finding.level != "ok":
                hints = [f"expected {finding.expected}"] * bool(finding.expected) + [finding.remedy]
                click.echo(" " * (width + 6) + "; ".join(h for h in hints if h))
        print_user_calls(finding.frames)
    rows = opened.parameters.rows()
    if not as_json:
        _print_parameters(rows)
    failed = [f for f in findings if f.level == "failure"]
    if as_json:
        result = {
            "bench": opened.config.name,
            "ok": not failed,
            "findings": [f.to_json() for f in findings],
            "parameters": [row.to_json() for row in rows],
        }
        click.echo(json.dumps(result))
    return EXIT_DEVICE if failed else EXIT_PASS


def _print_parameters(rows: Sequence[CrossCheck]) -> None:
    """Print what the bench takes for granted, and what measurements say about it."""
    from hil.bench.cross_checks.parameters import shown

    if not rows:
        return
    click.echo("\nWhat this bench takes for granted:")
    width = max(len(row.key) for row in rows)
    for row in rows:
        about = row.to_json()
        size = f" {row.unit}" if row.unit != "1" else ""
        off = f", {about['difference']:+.3g}{size}" if about["difference"] is not None else ""
        off += f", {row.bound}" if row.bound else ""
        on = f", on {row.on}" if row.on else ""
        says = (
            f"; {shown(about['says'])} would fit"
            if row.state == "contradicted" and about["says"] is not None
            else ""
        )
        colour = _STATES[row.state]
        click.echo(
            f"{click.style(f'{row.state:12}', fg=colour)} {row.key:{width}} "
            f"{shown(row.value)} ({row.by}{on}{off}{says})"
        )


def _fix(request: BenchRequest, fix: bool, out: Path | None) -> int:
    from hil.bench.doctor.port_findings import Host, udev_rules
    from hil.config.loading import load_bench
    from hil.core.errors import UsageError
    from hil.support.atomic_files import write_text

    if not fix:
        raise UsageError("--out is for the rules of --fix", remedy="give --fix, too, or redirect the output")
    rules = udev_rules(load_bench(request.bench, emulate=request.emulate), Host().sysfs)
    if out is None:
        click.echo(rules, nl=False)
    else:
        write_text(out, rules)
        click.echo(f"hil: wrote {out}; then: sudo udevadm control --reload, sudo udevadm trigger", err=True)
    return EXIT_PASS
