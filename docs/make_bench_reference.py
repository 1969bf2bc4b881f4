"""Writes docs/bench-file.md: every key of bench.toml with its default, from the docstrings of its models.

Run it after a change of the configuration (`python docs/make_bench_reference.py`); a test compares.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import typing
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from hil.config.bench import bench_model
from hil.config.field_types import bounds_of
from hil.core.device import DeviceModel
from hil.core.registry import kinds
from hil.core.signals import KINDS
from hil.fakes.imperfection_bounds import ranges

OPTIONS = {
    (kind, model.name): model.truth_options()
    for kind in KINDS
    for model in kinds()[kind].models
    if model.truth_options() is not None
}
"""What may be wrong with the emulated devices that this package has, by kind and model."""
PAGE = Path(__file__).with_name("bench-file.md")
HEAD = """# The bench file

One TOML file says everything about a bench. Unknown keys are errors, and every problem is reported at
once with its dotted path. A device whose table is missing is a device that the bench lacks. Any key can
be overridden for one run: `hil run PROCEDURE --set bench.loop.rate_hz=50`. Wheel order is FL, BL, BR, FR.
Every number has a range, both ends included; outside it the file is refused. A slash parts the ranges of a
list whose numbers differ.

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

## Several devices of one kind

A second IMU, or a range finder in front and one behind: double brackets, and a `name` for each.

```toml
[[imu]]
name = "imu"             # the bench's own

[[imu]]
name = "arm"
port = "/dev/serial/by-id/usb-..."

[emulation.imu_arm]
gyro_noise_rad_s = 0.01
```

On the bench a device is called `KIND_NAME`: here `imu_arm`. So it is named in `[emulation.imu_arm]`, `--set
bench.imu_arm.baud=9600`, `--emulate`, `--only` and `--fault imu_arm:stuck`, in what `hil doctor` and a stop
say, and in recordings: topic `/imu/data_arm`, columns `imu_arm_...`, frame `imu_arm`. Checks, procedures
(`needs`) and estimators of your own find its samples by `inputs.of("imu_arm")` and
`measurements.added["imu_arm"]`, as it delivered them, before the alignment.

* Of a kind that `hil` brings one is the bench's own: the one whose name is that of the kind, else the first.
  It is called `imu`, and the bench's estimators, checks and procedures use it alone. The others are recorded,
  and judged by silence, statuses and rate. Of two cameras only the bench's own gets wheel speeds.
* Of a kind that a package brings all are alike. One whose name is that of the kind (`name = "rangefinder"`)
  is called by it alone, for procedures that need `rangefinder`.
* A name has lower case letters, digits and `_`. No two of a kind have the same.
* What moves or holds the robot (servos, fan, propellers) is there once.
"""
_COLUMNS = "\n| key | default | range | meaning |\n|---|---|---|---|\n"


def page() -> str:
    """The whole page."""
    parts = list(_table(bench_model(), ""))
    for kind in KINDS:
        for model in kinds()[kind].models:
            parts += _table(model.config, kind, _of(model))
    for (kind, name), options in OPTIONS.items():
        parts += _options(kind, _of(kinds()[kind].model(name)), options)
    return HEAD + "".join(parts)


def _of(model: DeviceModel) -> str:
    """What a heading says beside the kind, where there are several models."""
    return f' with model = "{model.name}"' if len(kinds()[model.kind].models) > 1 else ""


def _options(device: str, of: str, options: type) -> Iterator[str]:
    """True imperfections of one emulated device: a dataclass."""
    described, allowed = _descriptions(options), ranges(options)
    yield f"\n## `[emulation.{device}]`{of}\n\n{inspect.cleandoc(options.__doc__ or '').splitlines()[0]}\n"
    yield _COLUMNS
    for field in dataclasses.fields(options):
        if field.default is not dataclasses.MISSING:
            range_text = _range(allowed.get(field.name, ()))
            meaning = described.get(field.name, "")
            yield f"| `{field.name}` | `{_toml(field.default)}` | {range_text} | {meaning} |\n"


def _table(model: type[BaseModel], path: str, of: str = "") -> Iterator[str]:
    described = _descriptions(model)
    rows, nested = [], []
    for name, field in model.model_fields.items():
        inner = _model_of(field.annotation)
        if name in kinds() and path in ("", "emulation"):
            continue
        if inner is not None:
            nested.append((inner, f"{path}.{name}".lstrip(".")))
            continue
        default = (
            "required" if field.is_required() else f"`{_toml(field.get_default(call_default_factory=True))}`"
        )
        bounds = [own.range_text() for _, own in bounds_of(field.annotation, field.metadata) if own]
        meaning = described.get(field.alias or name, "")
        rows.append(f"| `{field.alias or name}` | {default} | {_range(bounds)} | {meaning} |\n")
    if path:
        yield f"\n## `[{path}]`{of}\n\n"
        yield inspect.cleandoc(model.__doc__ or "").splitlines()[0] + "\n"
    if rows:
        yield _COLUMNS + "".join(rows)
    for inner, inner_path in nested:
        yield from _table(inner, inner_path)


def _range(bounds: Sequence[str]) -> str:
    """Bounds of a key's numbers: once where all are alike, else one after the other."""
    return " / ".join(bounds if len(set(bounds)) > 1 else bounds[:1])


def _model_of(annotation: Any) -> type[BaseModel] | None:
    for candidate in (annotation, *typing.get_args(annotation)):
        plain = typing.get_origin(candidate) is None  # list[int] is a class, too, in Python 3.10
        if plain and inspect.isclass(candidate) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _descriptions(model: type) -> dict[str, str]:
    """Meaning of each key from the section `Attributes:`, its bases' too; several may share one entry."""
    bases = [base for base in model.__bases__ if base not in (BaseModel, object)]
    described: dict[str, str] = {key: text for base in bases for key, text in _descriptions(base).items()}
    _, _, section = inspect.cleandoc(model.__doc__ or "").partition("Attributes:\n")
    for entry in re.split(r"\n(?= {4}\S)", section.rstrip()):
        names, _, text = entry.strip().partition(": ")
        plain = " ".join(text.split()).replace("|", "\\|")
        described |= {name.strip(): plain for name in names.split(",")}
    return described


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
