"""Which devices a run looks at: the others are left out of the bench, missing ones are named."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

from pydantic import AfterValidator

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


def leaving(wanted: Sequence[str], among: Iterable[str]) -> dict[str, object]:
    """Bench overrides that leave out the kinds `among` these, but for the wanted and those that hold."""
    known = kinds()
    return {
        name: None
        for name in among
        if not (name in wanted or known[name].holds_robot or known[name].guards_hold)
    }
