"""Rows of events for people: repeats that differ only in their numbers are one row with a count."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.core.signals import Event

GRAVE = ("warning", "error", "fatal")
"""Levels of events that every result reports."""
MOST_ROWS = 100
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class EventRows:
    """Events in the order in which each was first seen.

    Args:
        levels: levels of the events that count; all for none.

    Attributes:
        further: number of events beyond `MOST_ROWS` different ones.
    """

    def __init__(self, levels: Iterable[str] = ()) -> None:
        self._levels = frozenset(levels)
        self._rows: dict[tuple[str, str, str, str], dict[str, Any]] = {}
        self.further = 0

    def add(self, event: Event, t_s: float, bench: str = "") -> None:
        """Add an event.

        Args:
            event: the event.
            t_s: time of the event, s since the bench was opened.
            bench: name of the bench.
        """
        if not self._levels or event.level in self._levels:
            row = {"t_s": round(t_s, 3), "level": event.level, "device": event.source, "what": event.message}
            more = {"count": 1, "last_s": row["t_s"], "bench": bench, "left_out": event.distrusts}
            self.join({**row, **more})

    def join(self, row: Mapping[str, Any]) -> None:
        """Add a row of other event rows."""
        key = (row["bench"], row["level"], row["device"], without_numbers(row["what"]))
        known = self._rows.get(key)
        if known is not None:
            known["count"] += row["count"]
            known["last_s"] = max(known["last_s"], row["last_s"])
        elif len(self._rows) < MOST_ROWS:
            self._rows[key] = dict(row)
        else:
            self.further += row["count"]

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows.

        Returns:
            One table per row: `t_s`, `level`, `device`, `what`, `count`, `last_s`, `bench`, and `left_out`:
            true if the device's samples count for nothing from then on.
        """
        return [dict(row) for row in self._rows.values()]


def without_numbers(text: str) -> str:
    """A text with a sign in place of each number: texts that differ in their numbers only become the same."""
    return _NUMBER.sub("#", text)


def event_line(row: Mapping[str, Any]) -> str:
    """One line of text of a row."""
    again = f" ({row['count']} times until {row['last_s']:.2f} s)" if row["count"] > 1 else ""
    return f"{row['t_s']:.2f} s, {row['level']}, {row['device']}: {row['what']}{again}"


def injected_line(row: Mapping[str, Any]) -> str:
    """One line of text of a row of `hil.bench.injection.with_chips`."""
    where = "by hand" if row["at"] == "hand" else f"at the {row['at']}"
    if row["at"] != "chip":
        where += " of the real device"
    if row["begun_s"] is None:
        return f"{row['fault']} {where}: it did not begin"
    hit = "" if row["messages"] is None else f", {row['messages']} messages hit"
    return f"{row['fault']} {where}: {row['begun_s']:.2f} to {row['ended_s']:.2f} s{hit}"


def event_lines(rows: Sequence[Mapping[str, Any]], most: int = 12) -> list[str]:
    """Lines of text of the first rows, and how many further ones there are."""
    lines = [event_line(row) for row in rows[:most]]
    return lines + [f"{len(rows) - most} further kinds of events: result.json"] * (len(rows) > most)
