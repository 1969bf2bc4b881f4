"""The kinds of devices that may be the cause of a stop, by its reason."""

from collections.abc import Iterable, Mapping

SEPARATOR = ", "
"""Separates the kinds in the source of an event that may have several causes."""
_PRESSING = ("adhesion", "load_cells", "thrust")
_BY_REASON: Mapping[str, tuple[str, ...]] = {
    "adhesion": _PRESSING,
    "utilisation": _PRESSING,
    "adhesion_disagree": ("adhesion", "load_cells"),
    "thrust_disagree": ("thrust",),
    "weight": ("thrust", "servos"),
    "battery_low": ("adhesion",),
    "fan_hot": ("adhesion",),
    "hardware_error": ("servos",),
    "blocked": ("servos",),
    "servo_jump": ("servos",),
    "horn_slip": ("servos", "encoders"),
    "tracking": ("servos",),
    "heading": ("servos", "imu", "tracker"),
}
"""Reasons that are not listed: `stale_KIND` and `lost_KIND` imply that kind, others none."""
_OF_ONE = ("stale_", "lost_")


def suspects_of(reason: str) -> tuple[str, ...]:
    """Kinds of devices that the reason of a stop implies as possible causes; empty for none."""
    for begin in _OF_ONE:
        if reason.startswith(begin) and reason not in ("stale_estimate",):
            return (reason.removeprefix(begin),)
    return _BY_REASON.get(reason, ())


def together(names: Iterable[str]) -> str:
    """Join kinds into the source of an event that one of them may have caused."""
    return SEPARATOR.join(dict.fromkeys(names))
