"""What an emulated device is built from: its tables in the bench file, and its world."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from hil.core.errors import ConfigError, did_you_mean
from hil.fakes.imperfection_bounds import invalid_values
from hil.fakes.world import World

T = TypeVar("T")
_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
"""Validator of a dataclass, cached: making it takes longer than making most devices."""


@dataclass(frozen=True)
class EmulationRequest:
    """Everything that an emulated device is built from.

    Attributes:
        kind: device name on the bench, which also names its faults and random streams; further devices of a
            kind are called `KIND_NAME`.
        config: table of the device in the bench file.
        given: table `[emulation.KIND]`, not yet validated; `options` validates it.
        world: plant, clock, faults and random streams.
        name: name of its line or channel, unique in this process.
        standard_ports: True to serve it at the port where real devices of this kind are usually found.
    """

    kind: str
    config: Any
    given: Mapping[str, Any]
    world: World
    name: str
    standard_ports: bool = False

    def options(self, imperfections: type[T], **known: Any) -> T:
        """Validate `[emulation.KIND]` and return the true imperfections of the device.

        Args:
            imperfections: a dataclass with defaults.
            known: values of fields that follow from the bench; values of the bench file take precedence.

        Raises:
            ConfigError: names every invalid key.
        """
        names = [f.name for f in fields(imperfections)]  # type: ignore[arg-type]
        where = f"emulation.{self.kind}"
        problems = [
            f"{where}.{key}: unknown; {did_you_mean(key, names) or 'one of ' + ', '.join(names)}"
            for key in self.given
            if key not in names
        ]
        if not problems:
            problems = [f"{where}.{key}: {why}" for key, why in invalid_values(imperfections, self.given)]
        if not problems:
            try:
                made: T = _adapter(imperfections).validate_python({**known, **self.given})
                return made
            except ValidationError as error:
                problems = [
                    f"{where}.{'.'.join(map(str, e['loc']))}: {e['msg'].removeprefix('Value error, ')}"
                    for e in error.errors()
                ]
        raise ConfigError(f"[{where}]: {len(problems)} problem(s)", problems=tuple(problems))
