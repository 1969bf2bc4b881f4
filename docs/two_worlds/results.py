"""Figures that take long to make: one JSON object a line, so that a broken run goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "figures"
Row = dict[str, Any]


def known(name: str) -> list[Row]:
    """Rows that are there, oldest first."""
    path = FOLDER / f"{name}.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def fill(name: str, keys: Iterable[Row], make: Callable[..., Row]) -> list[Row]:
    """Make what is missing of `keys`, each `make(**key)`, and return the rows of all of them, in order."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    wanted = list(keys)
    for key in wanted:
        if not any(key.items() <= row.items() for row in known(name)):
            row = {**key, **make(**key)}
            with (FOLDER / f"{name}.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(name, row, flush=True)
    rows = known(name)
    return [next(row for row in rows if key.items() <= row.items()) for key in wanted]
