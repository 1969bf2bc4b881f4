"""The arguments for building an emulated device: world, table of the bench file, true parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from hil.core.errors import ConfigError, did_you_mean
from hil.fakes.truth_bounds import impossible
from hil.fakes.world import World

T = TypeVar("T")

_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
"""Of a dataclass, made once: it takes longer to make than most devices."""


@dataclass(frozen=True)
class EmulationRequest:
    """What an emulated device is built from.

    Attributes:
        kind: what the device is called on the bench, a further one of a kind `KIND_NAME`: the name of its
            faults and of its random streams.
        config: its table of the bench file.
        given: its `[emulation.KIND]`, as it stands there; `options` makes something of it.
        world: plant, clock, faults and random streams.
        name: of its line or channel, unlike that of any other in this process.
        standard_ports: whether to serve it where such devices are usually found.
    """

    kind: str
    config: Any
    given: Mapping[str, Any]
    world: World
    name: str
    standard_ports: bool = False

    def options(self, imperfections: type[T], **known: Any) -> T:
        """True imperfections of the device.

        Args:
            imperfections: a dataclass with defaults.
            known: values of fields that follow from the bench; what the bench file says comes first.

        Raises:
            ConfigError: naming every key that is wrong.
        """
        names = [f.name for f in fields(imperfections)]  # type: ignore[arg-type]
        where = f"emulation.{self.kind}"
        problems = [
            f"{where}.{key}: unknown; {did_you_mean(key, names) or 'one of ' + ', '.join(names)}"
            for key in self.given
            if key not in names
        ]
        if not problems:
            problems = [f"{where}.{key}: {why}" for key, why in impossible(imperfections, self.given)]
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
