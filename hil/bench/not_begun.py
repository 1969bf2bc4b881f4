"""Faults that a bench was closed before: they have not acted, so nothing has been tested of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hil.fakes.fault import Fault, describe
from hil.vocabulary.clock import NS_PER_S


def not_begun(faults: Iterable[Fault], world_ns: int) -> tuple[str, ...]:
    """Specs of those faults that begin later than a world has come.

    Args:
        faults: as they were planned.
        world_ns: how far the world has come.
    """
    return tuple(describe(fault) for fault in faults if fault.start_ns > world_ns)


def not_begun_in_words(specs: Sequence[str], world_ns: int) -> str:
    """One line for those who have asked for the faults."""
    what, began = ("fault", "it began") if len(specs) == 1 else ("faults", "they began")
    at_s = world_ns / NS_PER_S
    return (
        f"{what} {', '.join(specs)} never acted: the bench was closed at {at_s:.2f} s of world time, "
        f"before {began}"
    )
