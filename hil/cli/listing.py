"""`hil list`: the names that the command line and a bench file accept."""

import json
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any

import click

from hil.cli.completion_types import BENCH
from hil.cli.options import JSON
from hil.core.errors import EXIT_PASS
from hil.core.known_names import ESTIMATORS

_ESTIMATORS_IN_WORDS = {
    "odometry": "wheels alone, no filter",
    "ekf": "extended Kalman filter over wheels, IMU and camera",
    "ukf": "unscented Kalman filter over the same",
}


def _makers(bench: str) -> Mapping[str, Callable[[], Mapping[str, Any]]]:
    """What makes each list."""
    from hil.cli import declared
    from hil.config.shipped_profiles import profile_names, profile_summary
    from hil.procedure.shipped import shipped_summaries

    return {
        "procedures": shipped_summaries,
        "profiles": lambda: {name: profile_summary(name) for name in profile_names()},
        "devices": lambda: {n: {m.name: m.title for m in k.models} for n, k in declared.devices().items()},
        "faults": lambda: declared.faults(bench),
        "estimators": lambda: {name: _ESTIMATORS_IN_WORDS[name] for name in ESTIMATORS},
    }


WHAT = ("procedures", "profiles", "devices", "faults", "estimators")


@click.command(name="list")
@click.argument("what", type=click.Choice(WHAT), required=False, metavar="[WHAT]")
@click.option(
    "--bench",
    type=BENCH,
    default="emulated",
    help="Bench whose devices and faults to list, as if all were emulated [default: emulated].",
)
@JSON
def command(what: str | None, bench: str, as_json: bool) -> int:
    """List procedures, profiles, devices, faults or estimators; without WHAT, all of them.

    Example: hil list procedures
    """
    makers = _makers(bench)
    reported = {name: makers[name]() for name in ((what,) if what else WHAT)}
    if as_json:
        click.echo(json.dumps(reported))
        return EXIT_PASS
    for name, found in reported.items():
        _print(name if what is None else "", _ROWS.get(name, _as_they_are)(found))
    return EXIT_PASS


def _as_they_are(found: Mapping[str, str]) -> list[tuple[str, str]]:
    return list(found.items())


def _by_model(found: Mapping[str, Mapping[str, str]]) -> list[tuple[str, str]]:
    return [(f'{kind}.model = "{m}"', title) for kind, models in found.items() for m, title in models.items()]


def _by_faults(found: Mapping[str, Mapping[str, Sequence[str]]]) -> list[tuple[str, str]]:
    """Rows of devices and their faults; devices with the same faults share a row."""
    return [
        (", ".join(names), ", ".join(faults))
        for faults, names in groupby(found, key=lambda name: tuple(found[name]))
    ]


def _and_own(found: Mapping[str, str]) -> list[tuple[str, str]]:
    """Rows of the estimators, and how one of the user's own is named."""
    own = "of your own: a class, or a function that makes one, with reset(state) and update(measurements)"
    return [*found.items(), ("FILE.py:NAME", f"{own}; for hil replay --estimator")]


_ROWS: Mapping[str, Callable[[Any], list[tuple[str, str]]]] = {
    "devices": _by_model,
    "faults": _by_faults,
    "estimators": _and_own,
}


def _print(title: str, rows: Sequence[tuple[str, str]]) -> None:
    formatter = click.HelpFormatter(width=click.get_current_context().terminal_width)
    if title:
        formatter.write_heading(title)
        formatter.indent()
    formatter.write_dl(rows, col_max=36)
    click.echo(formatter.getvalue().rstrip("\n"))
