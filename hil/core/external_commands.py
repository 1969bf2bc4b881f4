"""What a controller that is another program commanded in one cycle, as it came: replay decides by it."""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.geometry import Array


@dataclass(frozen=True)
class ExternalCommand:
    """One message, unjudged.

    Attributes:
        t_ns: when it came, on the bench clock.
        stamp_ns: its own stamp, on the bench clock; None where it has none.
        kind: `joints`, or `twist` of the body.
        names: of joints; empty for a twist.
        position_rad, velocity_rad_s, effort: of joints, (n,), any of them shorter than `names`. A twist has
            only `velocity_rad_s`, (6,): linear x, y, z in m/s, then angular x, y, z in rad/s.
    """

    t_ns: int
    stamp_ns: int | None
    kind: str
    names: tuple[str, ...]
    position_rad: Array
    velocity_rad_s: Array
    effort: Array


@dataclass(frozen=True)
class ExternalCommands:
    """All of one cycle.

    Attributes:
        commands: oldest first.
        reason, trouble: why the robot must stop, as the network shows it: one word, and in words; empty for
            nothing. Words without a reason name the publishers when the newest command is late.
        only_synchronised: in lockstep, the stamp says no more than that the command is of no earlier cycle:
            the same run need not come again.
    """

    commands: tuple[ExternalCommand, ...] = ()
    reason: str = ""
    trouble: str = ""
    only_synchronised: bool = False
