"""Surfaces: friction, creep of the tyres on them, and patches where friction differs."""

from dataclasses import dataclass

from hil.core.errors import UsageError


@dataclass(frozen=True)
class Patch:
    """A rectangle of the surface with other friction; at a point, the first matching patch counts.

    Attributes:
        x_min_m, y_min_m, x_max_m, y_max_m: corners in the wall frame.
        friction_factor: factor on the surface's friction coefficient.
    """

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float
    friction_factor: float

    def __post_init__(self) -> None:
        if not (self.x_min_m < self.x_max_m and self.y_min_m < self.y_max_m and self.friction_factor >= 0):
            raise UsageError(f"{self} covers nothing", expected="min < max and a factor >= 0")


@dataclass(frozen=True)
class Surface:
    """A surface; all numbers are assumptions that may be tuned.

    Attributes:
        friction: coefficient of the friction cone.
        adhesive: True if ducted fan and propellers run on it; the floor needs neither.
        creep_along, creep_across: creep stiffness per normal load, along and across the wheel.
        patches: areas with other friction.
    """

    friction: float
    adhesive: bool = True
    creep_along: float = 10.0
    creep_across: float = 7.0
    patches: tuple[Patch, ...] = ()


_DUSTY = (
    Patch(0.45, -5.0, 0.65, 5.0, 0.8),
    Patch(0.9, -5.0, 1.05, 0.0, 0.85),
    Patch(-5.0, 0.5, 5.0, 0.7, 0.8),
)

SURFACES = {
    "floor": Surface(0.8, adhesive=False),
    "concrete": Surface(0.8),
    "melamine": Surface(0.45),
    "patchy": Surface(0.45, patches=_DUSTY),
}


def find_surface(name: str) -> Surface:
    """Return the preset of this name; raises `UsageError` that lists all presets."""
    if name not in SURFACES:
        raise UsageError(f"surface {name!r} is unknown", expected="one of " + ", ".join(SURFACES))
    return SURFACES[name]
