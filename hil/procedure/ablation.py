"""Settings of an ablation: which parts of a robot's record are known in each."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from hil.config.robot_record import PARTS
from hil.report.ablation_figure import EVERYTHING, NOTHING

Table = dict[str, dict[str, dict[str, float]]]
"""Setting -> line -> error, as in the JSON of `hil commission`."""


@dataclass(frozen=True)
class Setting:
    """One setting: its name, and the parts that are known in it."""

    name: str
    known: tuple[str, ...]


def settings_of(known: Sequence[str], alone: Collection[str]) -> tuple[Setting, ...]:
    """Nothing known, each part with what it was measured on top of, everything.

    Parts without a value for the bench file change nothing and have no setting of their own, and neither have
    signs (without them nothing moves as it should) and what holds the robot.

    Args:
        known: parts of the record.
        alone: parts that are tried by themselves.
    """
    if not known:
        return (Setting(NOTHING, ()),)
    single = []
    for name in known:
        if name not in alone or not PARTS[name].keys or name in ("signs", "steering", "hold"):
            continue
        below = tuple(n for n in PARTS[name].on if n in known)
        if {*below, name} == set(known):
            continue
        words = [n for n in (*below, name) if n != "signs"]
        single.append(Setting(f"{' and '.join(words)} known", (*below, name)))
    return (Setting(NOTHING, ()), *single, Setting(EVERYTHING, tuple(known)))
