"""Records how the benches of a run left the robot: a later hold does not cancel an earlier loss."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hil.core.errors import HilError
from hil.procedure.run_journal import Entry, Journal
from hil.procedure.run_sinks import StepTimer

if TYPE_CHECKING:
    from hil.bench.hold.held_state import Held


@dataclass(frozen=True)
class LeftBench:
    """State in which one bench left the robot.

    Attributes:
        name: name of the bench.
        held: its final report on the hold.
        tethered: the robot was on a tether, for example to find the force at which it slides.
    """

    name: str
    held: Held
    tethered: bool


class HoldRecord:
    """Collects the final hold report of each bench, and writes it to the journal.

    Args:
        journal: journal that receives a line for each bench.
        guard: its driven time shows whether the loop ran since a checkpoint was finished.
        past: journal entries about the benches of an interrupted run.
        finished: titles of the checkpoints that are not repeated; only their benches count.

    Attributes:
        opened: number of benches.
        events: events that the benches have seen, as rows of `hil.core.event_rows`.
    """

    def __init__(
        self, journal: Journal, guard: StepTimer, past: Sequence[Entry], finished: Collection[str]
    ) -> None:
        self._journal, self._guard = journal, guard
        self.opened = 0
        self._lost: list[LeftBench] = []
        self._last: LeftBench | None = None
        self._checkpoints: list[str] = []
        self._finished: tuple[str, int] | None = None
        self.events: list[Entry] = []
        for entry in past:
            if entry["checkpoint"] in finished:
                self._take_again(entry)

    def _take_again(self, entry: Entry) -> None:
        from hil.bench.hold.held_state import Held

        self.events += entry["events"]
        held = Held(entry["state"], entry["moved_m"], entry["why"], entry["wanted"])
        bench = LeftBench(f"{entry['bench']}, before this run was resumed", held, entry["tethered"])
        if bench.held.lost and not bench.tethered:
            self._lost.append(bench)

    @property
    def not_held(self) -> list[LeftBench]:
        """Benches that should have held the robot and did not; with a tether only the last closed one."""
        last = self._last
        return self._lost + ([last] if last is not None and last.held.lost and last.tethered else [])

    @property
    def held(self) -> Held | None:
        """Report of the first bench without hold, else of the last closed bench; None if none was closed."""
        worst = next(iter(self.not_held), self._last)
        return None if worst is None else worst.held

    def begin(self, label: str = "") -> str:
        """Count a bench that is about to be opened; return its name."""
        self.opened, self._finished = self.opened + 1, None
        return f"bench {self.opened}" + (f" ({label})" if label else "")

    def enter(self, checkpoint: str) -> None:
        """Note that a checkpoint has begun."""
        self._checkpoints.append(checkpoint)

    def leave(self, *, finished: bool) -> None:
        """Note that the checkpoint has ended; its bench may stay open."""
        title = self._checkpoints.pop()
        if finished:
            self._finished = title, self._guard.driven_ns

    def add(self, name: str, held: Held, events: Sequence[Entry] = (), *, tethered: bool) -> None:
        """Add the final report of a bench; ignore journal errors, since the result also has this report.

        Args:
            name: name of the bench.
            held: its final report on the hold; counts only where its servos were opened.
            events: events that it has seen.
            tethered: True if the robot was on a tether.
        """
        own = [row | {"bench": name} for row in events]
        self.events += own
        if not held.opened:
            return
        self._last = bench = LeftBench(name, held, tethered)
        if bench.held.lost and not tethered:
            self._lost.append(bench)
        where = {"bench": name, "checkpoint": self._checkpoint(), "tethered": tethered, "events": own}
        with suppress(HilError):
            self._journal.add("held", {**where, "wanted": held.wanted, **held.to_json()})

    def _checkpoint(self) -> str:
        """Return the checkpoint of the bench: the last one that ran its loop; empty for none."""
        if self._finished is not None and self._finished[1] == self._guard.driven_ns:
            return self._finished[0]
        return self._checkpoints[-1] if self._checkpoints else ""
