"""State in which a run left the robot, HELD or NOT HELD, as data and in words."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from hil.core.signals import SERVOS, ServoHold, Status

State = Literal["HELD", "NOT HELD", "not needed"]


@dataclass(frozen=True)
class Held:
    """State in which a run left the robot.

    Attributes:
        state: `not needed` where gravity does not pull along the surface.
        moved_m: largest displacement since the stop by camera, motion capture or wheels (not on a wall, where
            wheels do not detect a slide); None if not measured.
        why: the evidence; or what is missing, and what to do.
        opened: True if servos were opened; if not, nothing was done after which the robot must be held.
        by: measurement of what holds the robot; empty where none counts.
        confirmed: True if a second sensor confirms it.
        rests_on: keys of the bench file that scale it.
        wanted: True if the servos were commanded to hold, and the bench was not asked to release (`release`,
            `exit.policy`); still True if another program switched torque off.
    """

    state: State
    moved_m: float | None
    why: str
    wanted: bool = True
    opened: bool = True
    by: str = ""
    confirmed: bool = False
    rests_on: tuple[str, ...] = ()

    @property
    def lost(self) -> bool:
        """Whether the robot should be held and is not."""
        return self.state == "NOT HELD" and self.wanted

    def to_json(self) -> dict[str, object]:
        """JSON values for `result.json` and the summary of the live loop."""
        basis = {"by": self.by or None, "confirmed": self.confirmed, "rests_on": list(self.rests_on)}
        return {"state": self.state, "moved_m": self.moved_m, "why": self.why, **basis}

    def __str__(self) -> str:
        return held_in_words(self.to_json())


def held_in_words(held: Mapping[str, Any]) -> str:
    """One line of text from `Held.to_json`."""
    if held["moved_m"] is None:
        return f"{held['state']}: {held['why']}"
    least = "at least " if held["state"] == "NOT HELD" else ""
    return f"{held['state']}: moved {least}{1e3 * held['moved_m']:.1f} mm since the stop; {held['why']}"


def seen_in_words(held: Held) -> str:
    """One line of text on a robot that has not been set in motion yet."""
    return f"{held.state}: {held.why}"


def abandoned(why: str, *, on_wall: bool) -> Held:
    """The result for a robot whose bench ended before the check."""
    held = Held("NOT HELD", None, f"not checked: {why}")
    return held if on_wall else on_the_floor(held)


def on_the_floor(held: Held) -> Held:
    """The result for a robot that need not be held, because gravity does not act along the surface."""
    return replace(held, state="not needed", why=f"on the floor; {held.why}")


def untouched(why: str) -> Held:
    """The result for a robot whose devices were never opened: it need not be held."""
    return Held("not needed", None, why, wanted=False, opened=False)


def lacking_in_words(hold: ServoHold, *, emulated: bool) -> str:
    """Text with what the servos lack, and what to do about it where they are real."""
    silent = [text for text in hold.trouble.values() if Status.TIMEOUT.value in text]
    if len(silent) == len(SERVOS):
        found = "no servo answers: check the servos' supply, the bus and its adapter"
    else:
        found = ", ".join(f"{name} ({text})" for name, text in hold.trouble.items())
    found += "; torque comes back with the servos only while this program runs"
    return found if emulated else f"{found}: secure the robot"
