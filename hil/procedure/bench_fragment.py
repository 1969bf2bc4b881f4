"""Writes sections of `bench.toml` as a result of a run, to be reviewed and copied by a person."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from hil.config.robot_record.origin import comment, with_verdict
from hil.config.robot_record.overlay import identity
from hil.procedure.context import Context
from hil.support.atomic_files import write_text

NAME = "bench_fragment.toml"


def write_fragment(ctx: Context, values: Mapping[str, Mapping[str, Any]], why: str) -> Path:
    """Write the sections to `bench_fragment.toml` and attach this file to the run.

    Args:
        ctx: context of the run.
        values: section -> key -> value, as in `bench.toml`.
        why: description of the values, for the first line of the file.
    """
    path = ctx.folder / NAME
    config, seed = ctx.source.config, ctx.source.seed
    head = f"# {why}\n# From {config.name}, {ctx.started}: copy into the bench file.\n"
    head += comment(identity(config, seed))
    return ctx.attach("bench.toml fragment", write_text(path, head + tomli_w.dumps(dict(values))))


def seal_fragment(folder: Path, verdict: str) -> None:
    """Write the verdict of the run into its bench fragment, if there is one; raises `DataError`."""
    path = folder / NAME
    if path.is_file():
        write_text(path, with_verdict(path.read_text(encoding="utf-8"), verdict))
