"""How the benches of a run left the robot: what one did not hold, the next does not make good."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hil.core.errors import HilError
from hil.procedure.run_journal import Entry, Journal
from hil.procedure.step_timer import StepTimer

if TYPE_CHECKING:
    from hil.bench.hold.result import Held


@dataclass(frozen=True)
class LeftBench:
    """One bench.

    Attributes:
        name: what it is called.
        held: how it left the robot.
        tethered: the robot was on a tether, as for finding where it slides.
    """

    name: str
    held: Held
    tethered: bool


class HoldRecord:
    """Takes the last word of each bench, and keeps it in the journal.

    Args:
        journal: gets a line for each.
        guard: knows whether the loop ran since a checkpoint was finished.
        past: what the journal of an interrupted run says of its benches.
        finished: titles of the checkpoints that are not repeated: what their benches left counts.

    Attributes:
        opened: how many benches there were.
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
        for entry in past:
            if entry["checkpoint"] in finished:
                self._take_again(entry)

    def _take_again(self, entry: Entry) -> None:
        from hil.bench.hold.result import Held

        held = Held(entry["state"], entry["moved_m"], entry["why"], entry["wanted"])
        bench = LeftBench(f"{entry['bench']}, before this run was resumed", held, entry["tethered"])
        if bench.held.lost and not bench.tethered:
            self._lost.append(bench)

    @property
    def not_held(self) -> list[LeftBench]:
        """Those that should have held the robot and did not; on a tether only the one closed last."""
        last = self._last
        return self._lost + ([last] if last is not None and last.held.lost and last.tethered else [])

    @property
    def held(self) -> Held | None:
        """Of the first bench that was not held, else of the one that was closed last; None before that."""
        worst = next(iter(self.not_held), self._last)
        return None if worst is None else worst.held

    def begin(self, label: str = "") -> str:
        """What to call a bench that is about to be opened."""
        self.opened, self._finished = self.opened + 1, None
        return f"bench {self.opened}" + (f" ({label})" if label else "")

    def enter(self, checkpoint: str) -> None:
        """A checkpoint has begun."""
        self._checkpoints.append(checkpoint)

    def leave(self, *, finished: bool) -> None:
        """The checkpoint has ended; its bench may stay open."""
        title = self._checkpoints.pop()
        if finished:
            self._finished = title, self._guard.driven_ns

    def add(self, name: str, held: Held, *, tethered: bool) -> None:
        """Take a bench's last word; a journal that does not take it must not cost the result it is in."""
        self._last = bench = LeftBench(name, held, tethered)
        if bench.held.lost and not tethered:
            self._lost.append(bench)
        where = {"bench": name, "checkpoint": self._checkpoint(), "tethered": tethered}
        with suppress(HilError):
            self._journal.add("held", {**where, "wanted": held.wanted, **held.to_json()})

    def _checkpoint(self) -> str:
        """To which checkpoint the bench belongs: the last one that ran its loop; empty for none."""
        if self._finished is not None and self._finished[1] == self._guard.driven_ns:
            return self._finished[0]
        return self._checkpoints[-1] if self._checkpoints else ""
