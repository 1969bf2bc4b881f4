"""Commands of a controller in another program during one cycle, as received; replay uses them."""

from dataclasses import dataclass

from hil.core.geometry import Array


@dataclass(frozen=True)
class ExternalCommand:
    """One message as received, not checked yet.

    Attributes:
        t_ns: time of arrival, on the bench clock.
        stamp_ns: the message's stamp, on the bench clock; None without one.
        kind: `joints`, or `twist` of the body.
        names: joint names; empty for a twist.
        position_rad, velocity_rad_s, effort: (n,) joint values; each may be shorter than `names`. A twist has
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
    """All commands of one cycle.

    Attributes:
        commands: commands, the oldest first.
        reason, trouble: reason why the robot must stop, as seen on the network: one word, and a text; both
            empty for none. A text without a reason names the publishers when the newest command is late.
        only_synchronised: True if, in lockstep, the stamp shows only that the command belongs to no earlier
            cycle; a repeated run may differ.
    """

    commands: tuple[ExternalCommand, ...] = ()
    reason: str = ""
    trouble: str = ""
    only_synchronised: bool = False
