"""`hil calibration`: lists the versions of a calibration.toml, puts one in place, rolls back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.completion_types import BENCH
from hil.cli.nominal_robot_option import configured
from hil.cli.options import FILE, JSON, SuggestingGroup

if TYPE_CHECKING:
    from hil.calibration.versions import KeptVersion

_FILE = click.argument("file", type=FILE)
_BENCH = click.option(
    "--bench", type=BENCH, help="Bench file or profile that uses it: another robot's is refused."
)

_HELD_OUT = ("fresh_run", "leave_one_repetition_out")
"""Tables of `CalibrationFile.validation` on recordings that the fit did not see, the better one first."""


@click.group(cls=SuggestingGroup)
def command() -> None:
    """List, apply and roll back versions of a calibration.toml."""


@command.command("list")
@_FILE
@JSON
def list_versions(file: Path, as_json: bool) -> int:
    """Every version kept beside FILE, and which one is in place.

    Example: hil calibration list calibration.toml
    """
    from hil.calibration.versions import CalibrationVersions
    from hil.core.errors import ConfigError

    versions = [_described(v) for v in CalibrationVersions(file).versions()]
    if not versions:
        raise ConfigError(f"{file}: no calibration and no version of one", remedy="run odometry_calibration")
    if as_json:
        click.echo(json.dumps({"file": str(file), "versions": versions}))
        return 0
    click.echo(f"{'':2}{'version':8}{'verdict':10}{'RMSE mm':>8}  {'created':26}{'method':16}file")
    for row in versions:
        error = "-" if row["validation_rmse_m"] is None else f"{1e3 * row['validation_rmse_m']:.2f}"
        click.echo(
            f"{'*' if row['in_place'] else '':2}{row['version']:<8}{row['verdict'] or 'none':10}{error:>8}  "
            f"{row['created']:26}{row['method']:16}{row['path']}"
        )
    return 0


@command.command("apply")
@_FILE
@click.option("--version", type=int, help="Version kept beside FILE.")
@click.option("--from", "source", type=FILE, help="A calibration from elsewhere.")
@_BENCH
@JSON
def apply_version(
    file: Path, version: int | None, source: Path | None, bench: str | None, as_json: bool
) -> int:
    """Put a version in place as FILE; refused unless its validation passed.

    Example: hil calibration apply calibration.toml --version 3
    """
    from hil.calibration.calibration_file import read_calibration
    from hil.calibration.versions import CalibrationVersions
    from hil.core.errors import UsageError

    if (version is None) == (source is None):
        raise UsageError("which calibration?", expected="either --version N or --from FILE")
    versions, config = CalibrationVersions(file), configured(bench)
    if source is not None:
        return _done(versions.adopt(read_calibration(source), str(source), config), file, as_json)
    assert version is not None
    return _done(versions.apply(version, config), file, as_json)


@command.command()
@_FILE
@click.option("--version", type=int, help="Version to go back to [default: the one before].")
@_BENCH
@JSON
def rollback(file: Path, version: int | None, bench: str | None, as_json: bool) -> int:
    """Put an earlier version back in place as FILE.

    Example: hil calibration rollback calibration.toml
    """
    from hil.calibration.versions import CalibrationVersions

    return _done(CalibrationVersions(file).rollback(version, configured(bench)), file, as_json)


def _done(kept: KeptVersion, file: Path, as_json: bool) -> int:
    row = _described(kept)
    click.echo(json.dumps(row) if as_json else f"{file} is version {row['version']} ({row['created']})")
    return 0


def _described(kept: KeptVersion) -> dict[str, Any]:
    file = kept.file
    held_out = (file.validation.get(name, {}).get("mean") for name in _HELD_OUT)
    mean = next((row for row in held_out if row is not None), None)
    return {
        "version": file.version,
        "path": str(kept.path),
        "in_place": kept.in_place,
        "verdict": file.verdict,
        "created": file.created,
        "method": file.method,
        "validation_rmse_m": None if mean is None else mean.get("rmse_position_m"),
    }
