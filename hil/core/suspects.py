"""The kinds of devices that may be the cause of a stop, by its reason."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

SEPARATOR = ", "
"""Between the kinds in the source of an event that may have several causes."""
_PRESSING = ("adhesion", "load_cells", "thrust")
_BY_REASON: Mapping[str, tuple[str, ...]] = {
    "adhesion": _PRESSING,
    "utilisation": _PRESSING,
    "adhesion_disagree": ("adhesion", "load_cells"),
    "thrust_disagree": ("thrust",),
    "battery_low": ("adhesion",),
    "fan_hot": ("adhesion",),
    "hardware_error": ("servos",),
    "blocked": ("servos",),
    "servo_jump": ("servos",),
    "horn_slip": ("servos", "encoders"),
    "tracking": ("servos",),
    "heading": ("servos", "imu", "tracker"),
}
"""Of a reason that is not here, `stale_KIND` and `lost_KIND` accuse that kind, others none."""
_OF_ONE = ("stale_", "lost_")


def suspects_of(reason: str) -> tuple[str, ...]:
    """Kinds of devices that a stop for this reason accuses, whatever was found beside; empty for none."""
    for begin in _OF_ONE:
        if reason.startswith(begin) and reason not in ("stale_estimate",):
            return (reason.removeprefix(begin),)
    return _BY_REASON.get(reason, ())


def together(names: Iterable[str]) -> str:
    """The source of an event that one of several kinds of devices may have caused."""
    return SEPARATOR.join(dict.fromkeys(names))
