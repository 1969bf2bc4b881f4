"""Parts of several commands: options checked before anything is opened, and groups that suggest a name."""

import functools
import math
import shlex
import shutil
import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from hil.core.errors import UsageError
from hil.support.atomic_files import check_name

SEED = click.IntRange(min=0)
JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
PROGRESS = ("auto", "json")
"""The reader of progress, questions and figures on stderr: a person, or a program."""


def results_folder(name: str, out: Path | None, resumed_by: str | None) -> Path:
    """Results folder: `out`, else a new folder below `out/NAME`, or the latest one there to resume.

    Args:
        name: name of the procedure or series that is run.
        out: folder as given on the command line.
        resumed_by: file that marks a run as resumable; None for a new run.

    Raises:
        UsageError: there is nothing to resume.
    """
    if out is not None:
        return out
    base = Path("out") / name
    if resumed_by is None:
        return base / datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
    found = sorted(p.parent for p in base.glob(f"*/{resumed_by}"))
    if not found:
        raise UsageError(f"nothing to resume in {base}", remedy="name the results folder with --out")
    return found[-1]


class FiniteRange(click.FloatRange):
    """A float within a range; refuses NaN, which click's own type accepts."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Like click's; refuses a number that is not finite."""
        found = float(super().convert(value, param, ctx))
        if not math.isfinite(found):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return found


class FileName(click.Path):
    """A file or folder; a name that no file can have is refused before any access."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Like click's; raises `UsageError` for a name that no file can have."""
        found = super().convert(value, param, ctx)
        if isinstance(found, Path) and not (ctx is not None and ctx.resilient_parsing):
            check_name(found, param.opts[0] if isinstance(param, click.Option) else "")
        return found


class _Place(FileName):
    """A file or folder to write; refuses an empty name, as an unset shell variable gives."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Like click's, which takes an empty name for the current folder; this refuses it."""
        if value == "":
            self.fail("the name is empty", param, ctx)
        return super().convert(value, param, ctx)


FILE = FileName(path_type=Path)
"""Type of arguments and options that name a file or a folder."""
OUT = _Place(path_type=Path)
"""Type of `--out`."""
TOPICS = click.option(
    "--topics", type=FILE, help="Topics of another robot's bags, or columns of its CSV files (TOML)."
)


def truth_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options `--truth`, `--truth-body` and `--truth-offset`; the command gets a `TruthFile`, or None."""

    @functools.wraps(command)
    def joined(
        *args: Any, truth: Path | None, truth_body: str | None, truth_offset: str | None, **others: Any
    ) -> Any:
        return command(*args, truth=_truth_file(truth, truth_body, truth_offset), **others)

    for option in (
        click.option(
            "--truth-offset",
            metavar="SECONDS|fit",
            help="Time to add to the stamps of --truth, or fit: found by the speeds [default: one clock].",
        ),
        click.option(
            "--truth-body", metavar="NAME", help="The robot's body in --truth, where it holds several."
        ),
        click.option(
            "--truth",
            type=FILE,
            help="Ground truth of wheel logs in CSV: a file of Motive, QTM, Vicon, TUM or EuRoC, or a folder "
            "with one for each log, of the same name.",
        ),
    ):
        joined = option(joined)
    return joined


def _truth_file(path: Path | None, body: str | None, offset: str | None) -> Any:
    from hil.datasets.truth_files import TruthFile

    if path is None:
        if body is not None or offset is not None:
            raise UsageError("--truth-body and --truth-offset need --truth FILE")
        return None
    try:
        offset_s = 0.0 if offset in (None, "fit") else float(str(offset))
    except ValueError:
        offset_s = math.nan
    if not math.isfinite(offset_s):
        raise UsageError(f"--truth-offset {offset!r}", expected="seconds, or fit")
    return TruthFile(path, body, offset_s, fitted=offset == "fit")


class _CouplingType(click.ParamType):  # type: ignore[type-arg]
    """A `Coupling`: `fit`, a number for all wheels, or four."""

    name = "coupling"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """A `Coupling` of the text."""
        from hil.datasets.azimuth_coupling import Coupling

        if isinstance(value, Coupling) or value == "fit":
            return value if isinstance(value, Coupling) else Coupling()
        try:
            turns = [float(part) for part in str(value).split(",")]
        except ValueError:
            turns = []
        turns = turns * 4 if len(turns) == 1 else turns
        if len(turns) != 4 or not all(map(math.isfinite, turns)):
            self.fail(f"{value!r} is neither fit, nor one number, nor four between commas", param, ctx)
        return Coupling((turns[0], turns[1], turns[2], turns[3]))


COUPLING = click.option(
    "--coupling",
    type=_CouplingType(),
    metavar="fit|TURNS",
    help="Turns of the drive encoders per turn of the steering to take out (one, or four between commas), or "
    "fit: as they turn while the body rests.",
)
PLOTS = click.option("--plots", type=FILE, help="Folder for figures and an HTML page.")


class SuggestingGroup(click.Group):
    """A group of commands that suggests the nearest name for a mistyped command."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Like click's, with a suggestion for an unknown command, except during shell completion."""
        name, known = args[0], self.list_commands(ctx)
        if name not in known and not (name.startswith("-") or ctx.resilient_parsing):
            from hil.cli.suggestions import hint_for_command

            ctx.fail(f"no such command {name!r}; {hint_for_command(name, known)}")
        return super().resolve_command(ctx, args)


def _checked_view(ctx: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    if value is not None:
        from hil.monitor.sink import split_targets

        split_targets(value)
    return value


def rerun_option(help_text: str) -> Callable[[Any], Any]:
    """The option `--rerun`; an invalid target is refused before anything is opened."""
    return click.option("--rerun", "view", callback=_checked_view, help=help_text)


def on_recording_failure_option(what: str) -> Callable[[Any], Any]:
    """The option `--on-recording-failure`; its help names `what` the disk may no longer take."""
    return click.option(
        "--on-recording-failure",
        "on_failure",
        type=click.Choice(["stop", "go-on"]),
        default="stop",
        show_default=True,
        help=f"When the disk no longer takes {what}.",
    )


def say_rerun_files(view: str) -> None:
    """Print on stderr the files that `--rerun` has written, how to open them, and which are incomplete."""
    from hil.monitor.rrd_file import files_of, what_is_missing

    for name in files_of(part.strip() for part in view.split(",")):
        path = Path(name)
        if not path.is_file():
            continue
        if why := what_is_missing(path):
            remedy = "see what the disk has left; what the file holds can be shown"
            click.echo(f"hil: {name} is incomplete: {why}; {remedy}: {_opening(name)}", err=True)
            continue
        megabytes = path.stat().st_size / 1e6
        click.echo(f"hil: wrote {name} ({megabytes:.1f} MB); open it with: {_opening(name)}", err=True)


def _opening(name: str) -> str:
    """Command line that opens a file in the viewer; works also if the viewer is not on the PATH."""
    beside = Path(sys.executable).with_name("rerun")
    viewer = ["rerun"] if shutil.which("rerun") else [str(beside)] if beside.is_file() else []
    return shlex.join([*(viewer or [sys.executable, "-m", "rerun"]), name])
