"""Which devices a run looks at: the others are left out of the bench, missing ones are named."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from hil.procedure import Context
from hil.vocabulary.errors import ConfigError

Device = Literal["servos", "encoders", "imu", "tracker", "mocap"]
DEVICES: tuple[Device, ...] = ("servos", "encoders", "imu", "tracker", "mocap")


def only(ctx: Context, wanted: Sequence[str]) -> dict[str, object]:
    """Bench overrides that leave out all other devices.

    Raises:
        ConfigError: the bench lacks one that is wanted.
    """
    config = ctx.source.config
    lacking = [name for name in wanted if getattr(config, name) is None]
    if lacking:
        raise ConfigError(
            f"this run looks at {', '.join(lacking)}, which the bench {config.name!r} lacks",
            remedy="add the section(s) to the bench file, or say --set devices=... without them",
        )
    return {name: None for name in DEVICES if name not in wanted}
