"""True values of an emulated bench: the world is built from them, and the drivers from the bench file.

A number of a real bench file can be wrong, and the hardware does not care. So `[emulation.TABLE]` may hold
the true value of any key of `[TABLE]`, for `robot`, `environment` and every device; a key that is left out is
true as the bench file has it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from hil.bench.device_set_from_config import model_of
from hil.config.bench import BenchConfig
from hil.core.errors import ConfigError

OF_NO_DEVICE = ("environment", "robot")
"""Tables without a device that can have true values."""
_ADDRESSES = ("backend", "model", "name", "port", "server", "interface", "channel")
"""Keys that say where a device is, and have no truth."""


def true_bench(config: BenchConfig) -> BenchConfig:
    """The bench as it truly is: a configuration with the true values in the place of the file's.

    Raises:
        ConfigError: a true value is none that its key can have.
    """
    true: dict[str, BaseModel] = {}
    for name in (*OF_NO_DEVICE, *config.emulated()):
        given = _true_of_the_table(config, name)
        if given:
            true[name] = _with(getattr(config, name), given, f"emulation.{name}")
    return config.model_copy(update=true) if true else config


def imperfections(config: BenchConfig, name: str) -> Mapping[str, Any]:
    """The rest of `[emulation.NAME]`: options of the emulated device.

    Args:
        config: the bench configuration.
        name: name of the device.
    """
    true = _true_of_the_table(config, name)
    return {key: value for key, value in config.imperfections(name).items() if key not in true}


def _true_of_the_table(config: BenchConfig, name: str) -> dict[str, Any]:
    given = config.imperfections(name)
    if name in OF_NO_DEVICE or not given:
        return dict(given)
    options = model_of(config, name).truth_options() if model_of(config, name).chip else None
    own = {field.name for field in fields(options)} if is_dataclass(options) else set()
    keys = set(type(config.devices()[name]).model_fields) - own - {*_ADDRESSES}
    return {key: value for key, value in given.items() if key in keys}


def _with(table: BaseModel, given: Mapping[str, Any], where: str) -> BaseModel:
    """A table with other values, checked as those of the bench file."""
    try:
        return type(table).model_validate({**table.model_dump(by_alias=True, exclude_unset=True), **given})
    except ValidationError as error:
        problems = tuple(_problems(error, where))
        raise ConfigError(f"[{where}]: {len(problems)} problem(s)", problems=problems) from None


def _problems(error: ValidationError, where: str) -> Iterator[str]:
    for item in error.errors():
        key = ".".join(map(str, (where, *item["loc"])))
        yield f"{key}: {item['msg'].removeprefix('Value error, ')} (found {item['input']!r})"
