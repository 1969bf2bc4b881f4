"""Faults that only a hand can do: the operator switches the power of a real device, times are kept."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

from hil.core.clock import NS_PER_S
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.faults.fault import Fault

_FIRST = {
    "off": "switch the power of {} off, or pull its plug",
    "brownout": "interrupt the power of {} for a moment",
    "reset": "switch the power of {} off and on again",
}
_THEN = "switch the power of {} on again"


class Hand(Protocol):
    """The operator, who does something while the bench goes on."""

    @abstractmethod
    def say(self, text: str) -> None:
        """Say what to do, and that Enter is to be pressed then; never waits."""

    @abstractmethod
    def has_done(self) -> bool:
        """Whether Enter was pressed since the last call; never waits."""


class _Act:
    """One fault: what is asked, and when it was done, ns."""

    def __init__(self, fault: Fault) -> None:
        self.fault, self.asked = fault, 0
        self.done_ns: list[int] = []

    @property
    def steps(self) -> tuple[tuple[int | None, str], ...]:
        """Time at which each step is asked for, ns, None for at the end only; and its text."""
        first = self.fault.start_ns, _FIRST[self.fault.kind]
        return (first, (self.fault.end_ns, _THEN)) if self.fault.kind == "off" else (first,)


class HandFaults(Sink):
    """Sink that asks the operator for faults when their time has come, one at a time.

    Args:
        faults: faults of real devices of the kinds `off`, `brownout` and `reset`.
        hand: operator.
        world_ns: function that returns the time since the bench was opened, ns.
    """

    def __init__(self, faults: Sequence[Fault], hand: Hand, world_ns: Callable[[], int]) -> None:
        self._acts = [_Act(fault) for fault in sorted(faults, key=lambda fault: fault.start_ns)]
        self._hand, self._world_ns = hand, world_ns
        self._waiting: _Act | None = None

    def write(self, record: CycleRecord) -> None:
        """Ask for what is due, and take the time at which it was done."""
        t_ns = self._world_ns()
        if self._waiting is not None:
            if self._hand.has_done():
                self._waiting.done_ns.append(t_ns)
                self._waiting = None
            return
        for act in self._acts:
            step = len(act.done_ns)
            if step < len(act.steps) and (due_ns := act.steps[step][0]) is not None and due_ns <= t_ns:
                self._ask(act, step)
                return

    def _ask(self, act: _Act, step: int) -> None:
        self._waiting, act.asked = act, step + 1
        self._hand.has_done()  # what was typed before was no answer
        self._hand.say(f"{act.steps[step][1].format(act.fault.device)}, then press Enter")

    def end(self) -> None:
        """Ask for the power of devices that are still switched off, as the robot is being stopped."""
        for act in self._acts:
            if len(act.done_ns) == 1 and len(act.steps) == 2 and act.asked < 2:
                self._ask(act, 1)

    def report(self, end_ns: int) -> list[dict[str, object]]:
        """Each fault with the times at which a hand began and ended it, s; `messages` is 0 if none did.

        Args:
            end_ns: time at which the faults were ended, ns.
        """
        return [
            {
                "fault": str(act.fault),
                "at": "hand",
                "begun_s": act.done_ns[0] / NS_PER_S if act.done_ns else None,
                "ended_s": (act.done_ns[-1] if len(act.done_ns) == len(act.steps) else end_ns) / NS_PER_S,
                "messages": None if act.done_ns or act.fault.start_ns > end_ns else 0,
            }
            for act in self._acts
        ]

    def close(self) -> None:
        """Nothing to release."""
