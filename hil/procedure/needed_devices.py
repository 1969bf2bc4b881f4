"""Which devices a run looks at: the others are left out of the bench, missing ones are named."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

from pydantic import AfterValidator

from hil.config.bench import BenchConfig
from hil.core.errors import ConfigError
from hil.core.registry import further, kinds
from hil.procedure import Context


def _known(name: str) -> str:
    if name not in kinds():
        raise ValueError("expected some of " + ", ".join(kinds()))
    return name


Device = Annotated[str, AfterValidator(_known)]
"""Name of a kind of device, or of a further device of one."""


def only(ctx: Context, wanted: Sequence[str]) -> dict[str, object]:
    """Bench overrides that leave out all other devices, but for those that the robot's hold depends on.

    Raises:
        ConfigError: the bench lacks one that is wanted.
    """
    config = ctx.source.config
    lacking = [name for name in wanted if name not in config.devices()]
    if lacking:
        raise ConfigError(
            f"this run uses {', '.join(lacking)}, which the bench {config.name!r} lacks",
            remedy="add the section(s) to the bench file, or say --set devices="
            + ",".join(name for name in wanted if name not in lacking),
        )
    return leaving(wanted, (*kinds(), *further(config.devices())))


def with_own_devices(model: type[Any], given: Mapping[str, Any], config: BenchConfig) -> dict[str, Any]:
    """Parameters as given; where they name no devices to look at, those of the bench.

    Args:
        model: class of the parameters; its `devices`, if their default names kinds of devices, are meant.
        given: parameters by name.
        config: of the bench.
    """
    field = getattr(model, "model_fields", {}).get("devices")
    default = getattr(field, "default", None)
    if "devices" in given or not isinstance(default, tuple) or not kinds().keys() >= set(default):
        return dict(given)
    return {**given, "devices": tuple(name for name in default if name in config.devices())}


def leaving(wanted: Sequence[str], among: Iterable[str]) -> dict[str, object]:
    """Bench overrides that leave out the kinds `among` these, but for the wanted and those that hold."""
    known = kinds()
    return {
        name: None
        for name in among
        if not (name in wanted or known[name].holds_robot or known[name].guards_hold)
    }
