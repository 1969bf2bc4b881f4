"""Adds suggestions and an example to click's own messages about a mistyped command line."""

import re
from pathlib import Path

import click

from hil.core.errors import did_you_mean

_NOT_ONE_OF = re.compile(r"'(?P<given>[^']*)' is not one of (?P<known>.*?)\.?$", re.S)
_NO_RANGE = re.compile(r"('[^']*')( is not a valid (?:integer|float)(?: range)?\.?)$")
_EXTRA = re.compile(r"^Got unexpected extra arguments? \((?P<given>.*)\)$", re.S)
_EXAMPLE = re.compile(r"^\s*(Example: .*(?:\n\s+\S.*)*)", re.M)
_SAID: dict[str, tuple[str, ...]] = {
    "show": ("open",),
    "view": ("open",),
    "ls": ("list",),
    "rm": ("delete",),
    "remove": ("delete",),
    "undo": ("rollback",),
    "start": ("on",),
    "stop": ("off",),
    "fan": ("adhesion",),
    "check": ("doctor",),
    "test": ("run",),
    "scan": ("discover",),
    "compare": ("report", "diff"),
    "serve": ("emulate",),
}
_OPTIONS = ("help", "version")


def hint_for_command(given: str, known: list[str]) -> str:
    """Suggestion for an unknown command: an option, or another command."""
    if given in _OPTIONS:
        return f"did you mean --{given}?"
    other = next((name for name in _SAID.get(given, ()) if name in known), None)
    if other is not None:
        return f"did you mean {other}?"
    return did_you_mean(given, known) or f"one of {', '.join(known)}"


def explained(error: click.ClickException) -> click.ClickException:
    """A click error with a suggestion or an example added; unchanged where there is none."""
    if not isinstance(error, click.UsageError):
        return error
    ctx, text = error.ctx, error.format_message()
    if isinstance(error, click.MissingParameter):
        better = f"{text} {_example(ctx)}".strip()
    elif isinstance(error, click.BadParameter):
        better = _of_value(text)
    else:
        better = _of_extra(text, ctx)
    return error if better == text else click.UsageError(better, ctx)


def _example(ctx: click.Context | None) -> str:
    found = _EXAMPLE.search((ctx.command.help or "") if ctx is not None else "")
    return " ".join(found[1].split()) if found else ""


def _of_value(text: str) -> str:
    if wrong := _NOT_ONE_OF.search(text):
        hint = did_you_mean(wrong["given"], re.findall(r"'([^']*)'", wrong["known"]))
        return f"{text.rstrip('.')}; {hint}" if hint else text
    if wrong := _NO_RANGE.search(text):
        return f"{text[: wrong.start(2)]} is not a {'whole ' if 'integer' in wrong[2] else ''}number."
    return text


def _of_extra(text: str, ctx: click.Context | None) -> str:
    """Text of an error about extra arguments; suggests `--bench` if the first one names a bench."""
    wrong = _EXTRA.match(text)
    if wrong is None or ctx is None:
        return text
    given = wrong["given"].split()[0]
    options = {name for p in ctx.command.params for name in p.opts}
    from hil.config.shipped_profiles import profile_names

    if "--bench" in options and (Path(given).suffix == ".toml" or given in profile_names()):
        return f"{text}; did you mean --bench {given}?"
    return text
