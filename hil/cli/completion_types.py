"""Click types with shell completion: benches, faults, procedures, results.

Their values are plain texts; each is checked where it is used.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from hil.cli.options import FileName
from hil.core.known_names import LAWS

Known = Mapping[str, str]
"""Possible words with their descriptions; a description may be empty."""
Find = Callable[[click.Context, str], Known]
_OUT = Path("out")
_DEFAULT_BENCH = "emulated"


def _items(found: Known, incomplete: str) -> list[CompletionItem[str]]:
    return [
        CompletionItem(w, help=reported or None) for w, reported in found.items() if w.startswith(incomplete)
    ]


class Words(click.types.StringParamType):
    """Text type that completes to the words that `find` returns, and to files if `files` is set.

    Args:
        find: function to the possible words, given the context and the incomplete word.
        files: True if the value may also be the name of a file.
    """

    def __init__(self, find: Find, *, files: bool = False) -> None:
        self._find, self._files = find, files

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem[str]]:
        """What the word may become."""
        file = [CompletionItem(incomplete, type="file")] if self._files else []
        return [*file, *_items(self._find(ctx, incomplete), incomplete)]


class _ResultsFolder(FileName):
    """Type of a results folder; completes to the paths of earlier runs."""

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem[str]]:
        """What the word may become."""
        runs = {str(_OUT / name): reported for name, reported in _results(_OUT).items()}
        return [CompletionItem(incomplete, type="file"), *_items(runs, incomplete)]


def _given(ctx: click.Context, name: str) -> Any:
    """The value of a parameter on this line; None where it has none.

    click parses nothing of a line that ends in an option without its value, so this parses the line again
    without that option. `ctx.obj` holds the words before the incomplete one.
    """
    words = list(ctx.obj or ())
    words = words[words.index(ctx.info_name) + 1 :] if ctx.info_name in words else []
    words = words[:-1] if words and words[-1].startswith("-") else words
    line = ctx.command.make_context(ctx.info_name, words, parent=ctx.parent, resilient_parsing=True)
    return line.params.get(name)


def _with_files(found: Known, ending: str, incomplete: str) -> Known:
    """Add the files with this ending in the folder that has been typed."""
    folder = Path(incomplete).parent if "/" in incomplete else Path()
    return {**found, **{str(path): "" for path in sorted(folder.glob(f"*{ending}"))}}


def _benches(ctx: click.Context, incomplete: str) -> Known:
    from hil.config.shipped_profiles import profile_names, profile_summary

    return _with_files({n: profile_summary(n) for n in profile_names()}, ".toml", incomplete)


def _procedures(ctx: click.Context, incomplete: str) -> Known:
    from hil.procedure.shipped import shipped_names

    return dict.fromkeys(shipped_names(), "")


def _scripts(ctx: click.Context, incomplete: str) -> Known:
    return _with_files(_procedures(ctx, incomplete), ".py", incomplete)


def _devices(ctx: click.Context, incomplete: str) -> Known:
    from hil.cli import declared

    return {**{name: kind.noun for name, kind in declared.devices().items()}, "all": ""}


def _faults(ctx: click.Context, incomplete: str) -> Known:
    """Complete the device first; once it is typed or unique, its faults."""
    from hil.cli import declared

    known = declared.faults(_given(ctx, "bench") or _DEFAULT_BENCH)
    meant = [device for device in known if f"{device}:".startswith(incomplete)]
    if len(meant) > 1:
        return {f"{device}:": "" for device in meant}
    return {
        f"{d}:{kind}": _optional(options) for d, kinds in known.items() for kind, options in kinds.items()
    }


def _optional(options: Iterable[str]) -> str:
    return f"options {' '.join(options)}" if options else ""


def _settings(ctx: click.Context, incomplete: str) -> Known:
    """The parameters of the procedure on this line, with their defaults."""
    from hil.procedure.parameters import described
    from hil.procedure.procedure_lookup import load_procedure

    script = _given(ctx, "script")
    if not script:
        return {}
    return {f"{d.name}={d.default}": d.help for d in described(load_procedure(script).parameters)}


def _results(folder: Path) -> Known:
    from hil.report.history.index import find_results

    if not folder.is_dir():
        return {}
    return {kept.name: kept.verdict or kept.kind for kept in find_results(folder)}


def _runs(ctx: click.Context, incomplete: str) -> Known:
    found = _results(Path(_given(ctx, "where") or _OUT))
    return {"last": "the latest", **found} if found and ctx.command.name == "open" else found


BENCH: Any = Words(_benches, files=True)
"""A shipped profile, or a bench file."""
CONTROLLER: Any = Words(lambda ctx, incomplete: dict.fromkeys(LAWS, ""), files=True)
"""A control law, or a controller in a Python file."""
DEVICES: Any = Words(_devices)
"""Devices of a bench."""
FAULT: Any = Words(_faults, files=True)
"""A fault, or a file of them."""
PROCEDURE: Any = Words(_procedures)
"""The name of a shipped procedure."""
RESULTS: Any = _ResultsFolder(path_type=Path)
"""A folder that a run has left."""
RUN: Any = Words(_runs)
"""The name of an earlier run."""
SCRIPT: Any = Words(_scripts, files=True)
"""A shipped procedure, or a script."""
SETTING: Any = Words(_settings)
"""A parameter of the procedure, as KEY=VALUE."""
