"""Reads faults from a spec, a `Fault`, or a TOML timeline file.

A timeline is a list of tables, seconds counted from the world's start::

    [[fault]]
    device = "imu"
    kind = "stuck"
    at_s = 2.0
    duration_s = 3.0          # without it: until the end
    options = { scale = 2.0 } # as the device names them
"""

from collections.abc import Iterable
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from hil.core.errors import ConfigError, UsageError
from hil.faults.fault import Fault, make_fault, parse_fault
from hil.support.file_reading import read_toml


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid")

    device: str
    kind: str
    at_s: float = 0.0
    duration_s: float | None = None
    options: dict[str, float | str] = {}


class _Timeline(BaseModel):
    model_config = ConfigDict(extra="forbid")

    fault: tuple[_Entry, ...]


def read_faults(given: Iterable[str | Fault]) -> tuple[Fault, ...]:
    """Return all faults of specs, `Fault` objects and timeline files (names that end in `.toml`), in order.

    Raises:
        ConfigError: a timeline file is invalid; lists every problem in it.
        UsageError: a spec is invalid.
    """
    faults: list[Fault] = []
    for item in given:
        if isinstance(item, Fault):
            faults.append(item)
        elif item.endswith(".toml"):
            faults += _from_file(Path(item))
        else:
            faults.append(parse_fault(item))
    return tuple(faults)


def _from_file(path: Path) -> list[Fault]:
    try:
        timeline = _Timeline.model_validate(read_toml(path))
        return [
            make_fault(e.device, e.kind, at=e.at_s, duration=e.duration_s, **e.options)
            for e in timeline.fault
        ]
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()]
    except (UsageError, TypeError) as error:
        problems = [str(error)]
    raise ConfigError(
        f"{path}: not a fault timeline",
        problems=tuple(problems),
        expected="tables [[fault]] with device, kind, at_s, duration_s and options",
    )
