"""Selects the devices that a run uses: leaves the others out of the bench, reports missing ones."""

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
"""Name of a kind of device, or of an additional device of a kind."""


def only(ctx: Context, wanted: Sequence[str]) -> dict[str, object]:
    """Return bench overrides that leave out all other devices, except those that hold the robot or guard it.

    Raises:
        ConfigError: the bench lacks a wanted device.
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
    """Return the given parameters; without `devices`, use the default devices that the bench has.

    Args:
        model: class of the parameters; only changed if the default of `devices` names kinds of devices.
        given: parameters by name.
        config: configuration of the bench.
    """
    field = getattr(model, "model_fields", {}).get("devices")
    default = getattr(field, "default", None)
    if "devices" in given or not isinstance(default, tuple) or not kinds().keys() >= set(default):
        return dict(given)
    return {**given, "devices": tuple(name for name in default if name in config.devices())}


def leaving(wanted: Sequence[str], among: Iterable[str]) -> dict[str, object]:
    """Return bench overrides that remove the kinds `among`, except wanted ones and those for the hold."""
    known = kinds()
    return {
        name: None
        for name in among
        if not (name in wanted or known[name].holds_robot or known[name].guards_hold)
    }
