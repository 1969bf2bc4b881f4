"""The `hil` command: finds the sub-command, runs it, turns our errors into one line and an exit code.

Each sub-command is a module, imported only when it is called, so that `hil --help` is quick.
"""

import importlib
import importlib.util
import json
import logging
import os
import sys
import traceback
from collections.abc import Sequence

import click

from hil import __version__
from hil.cli.closed_output import Answered, Output, error_as_json, print_user_calls
from hil.cli.options import PROGRESS, SuggestingGroup
from hil.core.errors import EXIT_ABORTED, Aborted, DefectError, HilError, UsageError
from hil.core.errors import error_text as in_a_line
from hil.support.file_reading import printable
from hil.support.interrupt_signals import ignore_stop_signals

# Set before numpy is imported by a command: its matrices here are small, and threads of the linear
# algebra library then cost up to ten times what they bring when another process uses a core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMANDS = {
    "accept": "the first day: doctor, contract of every device, turning wheels, one page to sign",
    "adhesion": "the fan that presses the robot on its wall: on, off, status, watch",
    "calibrate": "fit the odometry parameters to recordings, with validation",
    "calibration": "list, apply and roll back versions of a calibration",
    "campaign": "a procedure over many seeds and settings, in parallel",
    "commission": "from a robot as delivered to a verified wall run: all procedures in order",
    "console": "the bench in a browser: devices, procedures, live figures, STOP, history",
    "demo-data": "write a generated data set of the six motions",
    "discover": "find ports, IDs and baud rates; print a ready bench.toml",
    "doctor": "examine every device of a bench without moving it",
    "emulate": "serve the emulated devices to any client",
    "evaluate": "odometry error table of recordings",
    "export": "a recording as CSV or Parquet",
    "faults": "every fault of every emulated device: is the robot held, and is the cause named",
    "info": "versions for a bug report",
    "jog": "one wheel, one steering axis or the body by the keyboard, while a key is held",
    "list": "procedures, profiles, devices, faults and estimators that there are",
    "live": "the control-estimate loop in real time, with monitoring",
    "replay": "re-run estimation on a recording, or verify that what it decided repeats",
    "report": "the HTML page of a run, or a comparison of several",
    "results": "earlier runs: list, open, search, trends",
    "robot": "the record of a robot: show, compare, apply and roll back its versions",
    "run": "run a procedure on a bench",
    "setup": "write one servo's ID, baud rate and operating mode",
    "tune": "fit the estimator's noise to recordings with ground truth",
    "twin": "how far recordings of a robot and the emulated robot are apart",
}


_COMPLETE = "_HIL_COMPLETE"
"""Environment variable of a completion request: `bash_complete` for words, `bash_source` for the script."""


class LazyGroup(SuggestingGroup):
    """A click group that imports a command's module on first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands that are part of this installation."""
        return [n for n in COMMANDS if importlib.util.find_spec(_module(n)) is not None]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        if cmd_name not in self.list_commands(ctx):
            return None
        command = importlib.import_module(_module(cmd_name)).command
        assert isinstance(command, click.Command)
        command.name = cmd_name  # their functions are all called `command`
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        rows = [(n, COMMANDS[n]) for n in self.list_commands(ctx)]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


def _module(name: str) -> str:
    module = "listing" if name == "list" else name.replace("-", "_")  # `list` would hide Python's own here
    return f"hil.cli.{module}"


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__)
@click.option(
    "--progress",
    type=click.Choice(PROGRESS),
    default=PROGRESS[0],
    show_default=True,
    help="Reader of stderr: a person, or a program (one JSON object per line).",
)
@click.option("-v", "--verbose", count=True, help="More messages on stderr (twice: debug).")
def cli(verbose: int, progress: str) -> None:
    """Hardware-in-the-loop bench for a 4WIS4WID wall-climbing robot."""
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(level=level, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    With `--json` an error is also printed on stdout, as the only object there. An unexpected exception is
    printed with its traceback.

    Returns:
        The exit code: 0 pass, 1 a limit failed, 2 usage or configuration, 3 device, 4 aborted, or a defect.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    answered = Answered()
    try:
        result = cli.main(args=words, prog_name="hil", standalone_mode=False, obj=answered)
    except HilError as error:
        reported = error_as_json(error)
        print_user_calls(reported["frames"])
        click.echo(printable(f"hil: {error}"), err=True)
    except click.exceptions.Exit as leave:
        return leave.exit_code
    except click.ClickException as error:
        from hil.cli.suggestions import explained

        better = explained(error)
        better.show(sys.stderr)
        reported = error_as_json(UsageError(better.format_message()))
    except (click.exceptions.Abort, KeyboardInterrupt) as error:
        word = "interrupted" if isinstance(error, KeyboardInterrupt) else "aborted"
        click.echo(f"hil: {word}", err=True)
        reported = error_as_json(Aborted(word))
    except (Exception, SystemExit, GeneratorExit) as error:
        traceback.print_exc()
        defect = DefectError(in_a_line(error))
        click.echo(printable(f"hil: {defect}"), err=True)
        reported = error_as_json(defect)
    else:
        return result if isinstance(result, int) else 0
    if "--json" in words and not answered.already:
        click.echo(json.dumps({"error": reported}))
    return int(reported["exit_code"])


def _complete(asked: str) -> int:
    from hil.cli.completion import answer

    return answer(cli, _COMPLETE, asked)


def script() -> None:
    """Console entry point."""
    try:
        output = Output()
    except Aborted as error:
        click.echo(f"hil: {error}", err=True)
        sys.exit(EXIT_ABORTED)
    try:
        asked_by_shell = os.environ.get(_COMPLETE)
        code = _complete(asked_by_shell) if asked_by_shell else main()
    except Aborted:  # the error message cannot be written either
        code = EXIT_ABORTED
    ignore_stop_signals()
    sys.exit(code if output.finish() else EXIT_ABORTED)
