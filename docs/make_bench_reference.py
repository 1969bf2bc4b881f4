"""Writes docs/bench-file.md: every key of bench.toml with its default, from the docstrings of its models.

Run it after a change of the configuration (`python docs/make_bench_reference.py`); a test compares.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from hil.config.bench import BenchConfig
from hil.config.values import Within
from hil.fakes.encoders import EncoderTruthOptions
from hil.fakes.imu import ImuTruthOptions
from hil.fakes.mocap import MocapTruthOptions
from hil.fakes.servos import ServoBusOptions
from hil.fakes.tracker import TrackerTruthOptions

OPTIONS = {
    "servos": ServoBusOptions,
    "encoders": EncoderTruthOptions,
    "imu": ImuTruthOptions,
    "tracker": TrackerTruthOptions,
    "mocap": MocapTruthOptions,
}
PAGE = Path(__file__).with_name("bench-file.md")
HEAD = """# The bench file

One TOML file says everything about a bench. Unknown keys are errors, and every problem is reported at
once with its dotted path. A device whose table is missing is a device that the bench lacks. Any key can
be overridden for one run: `hil run PROCEDURE --set bench.loop.rate_hz=50`. Wheel order is FL, BL, BR, FR.

A whole bench can be three lines a device:

```toml
schema = 1
name = "my bench"

[servos]
port = "/dev/serial/by-id/usb-FTDI_..."
baud = 3000000

[imu]
backend = "emulated"     # this one is not there yet
```

`hil discover` prints such a file from what it finds. This page is written by
`docs/make_bench_reference.py` from the configuration itself.
"""


def page() -> str:
    """The whole page."""
    parts = list(_table(BenchConfig, ""))
    parts += [part for device, options in OPTIONS.items() for part in _options(device, options)]
    return HEAD + "".join(parts)


def _options(device: str, options: type) -> Iterator[str]:
    """True imperfections of one emulated device: a dataclass."""
    told = _told(options)
    yield f"\n## `[emulation.{device}]`\n\n{inspect.cleandoc(options.__doc__ or '').splitlines()[0]}\n"
    yield "\n| key | default | meaning |\n|---|---|---|\n"
    for field in dataclasses.fields(options):
        if field.default is not dataclasses.MISSING:
            yield f"| `{field.name}` | `{_toml(field.default)}` | {told.get(field.name, '')} |\n"


def _table(model: type[BaseModel], path: str) -> Iterator[str]:
    told = _told(model)
    rows, nested = [], []
    for name, field in model.model_fields.items():
        inner = _model_of(field.annotation)
        if path == "emulation" and name in OPTIONS:
            continue
        if inner is not None:
            nested.append((inner, f"{path}.{name}".lstrip(".")))
            continue
        default = (
            "required" if field.is_required() else f"`{_toml(field.get_default(call_default_factory=True))}`"
        )
        meaning = told.get(field.alias or name, "") + "".join(
            f" {bound.low:g} to {bound.high:g}." for bound in field.metadata if isinstance(bound, Within)
        )
        rows.append(f"| `{field.alias or name}` | {default} | {meaning} |\n")
    if path:
        yield f"\n## `[{path}]`\n\n"
        yield inspect.cleandoc(model.__doc__ or "").splitlines()[0] + "\n"
    if rows:
        yield "\n| key | default | meaning |\n|---|---|---|\n" + "".join(rows)
    for inner, inner_path in nested:
        yield from _table(inner, inner_path)


def _model_of(annotation: Any) -> type[BaseModel] | None:
    for candidate in (annotation, *typing.get_args(annotation)):
        if inspect.isclass(candidate) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _told(model: type) -> dict[str, str]:
    """Meaning of each key from the section `Attributes:`; several may share one entry."""
    _, _, section = inspect.cleandoc(model.__doc__ or "").partition("Attributes:\n")
    told: dict[str, str] = {}
    for entry in re.split(r"\n(?= {4}\S)", section.rstrip()):
        names, _, text = entry.strip().partition(": ")
        plain = " ".join(text.split()).replace("|", "\\|")
        told |= {name.strip(): plain for name in names.split(",")}
    return told


def _toml(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0)
