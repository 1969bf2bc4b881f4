"""Events that a bench has seen: those of its cycles, and its own warnings, for results and reports."""

from collections.abc import Callable
from typing import Any

from hil.core.clock import NS_PER_S
from hil.core.event_rows import GRAVE, EventRows
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord, Event
from hil.core.stop_suspects import SEPARATOR


class SeenEvents(Sink):
    """Collects the events of warning and above of one bench.

    Args:
        since_begun_ns: function from a time of the bench's clock, ns, to the time since the bench was opened.

    Attributes:
        contradicting: events that contradict the bench file, by key.
        first_ns: time of the first cycle by the bench's clock, ns; None before it.
        distrusted: first event of each device whose samples count for nothing from then on.
    """

    def __init__(self, since_begun_ns: Callable[[int], int]) -> None:
        self._since_begun_ns = since_begun_ns
        self._rows = EventRows(GRAVE)
        self.first_ns: int | None = None
        self.distrusted: dict[str, Event] = {}
        self.contradicting: dict[str, Event] = {}

    def write(self, record: CycleRecord) -> None:
        """Add the events of one cycle."""
        if self.first_ns is None:
            self.first_ns = record.start_ns
        for event in record.events:
            self.add(event)

    def add(self, event: Event) -> None:
        """Add an event."""
        self._rows.add(event, self._since_begun_ns(event.t_ns) / NS_PER_S)
        for key in filter(None, event.key.split(SEPARATOR)):
            self.contradicting[key] = event
        if event.distrusts:
            self.distrusted.setdefault(event.source, event)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def rows(self) -> list[dict[str, Any]]:
        """Rows as `EventRows.rows` returns them."""
        return self._rows.rows()
