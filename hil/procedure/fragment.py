"""A piece of `bench.toml` as a result: to be looked at and copied, never installed by itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from hil.procedure import Context
from hil.vocabulary.files import write_text

NAME = "bench_fragment.toml"


def write_fragment(ctx: Context, values: Mapping[str, Mapping[str, Any]], why: str) -> Path:
    """Write the sections and attach them.

    Args:
        ctx: of the run.
        values: section -> key -> value, as in `bench.toml`.
        why: what they are, for the first line of the file.
    """
    path = ctx.folder / NAME
    head = f"# {why}\n# From {ctx.source.config.name}, {ctx.started}: copy into the bench file.\n"
    return ctx.attach("bench.toml fragment", write_text(path, head + tomli_w.dumps(dict(values))))
