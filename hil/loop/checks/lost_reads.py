"""Reports servos that miss many reads, though a complete read comes often enough that nothing stops."""

from hil.core.signals import SERVOS, Event, Inputs, Status
from hil.loop.cycle_data import Check, Cycle

_WINDOW_NS, _SHARE, _FEWEST_READS, _LOST_NS = 500_000_000, 0.1, 20, 15_000_000
"""Time over which lost reads are counted, share that is reported, least number of reads, and time that this
computer may lose meanwhile (ns): what it loses looks like lost reads."""


class LostReads(Check):
    """Counts the lost reads of each servo in one run.

    Args:
        names: servos in messages, in the order of `SERVOS`.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._began_ns: int | None = None
        self._reads, self._lost, self._lost_ns = 0, [0] * len(SERVOS), 0
        self._told: set[int] = set()

    def on_samples(self, cycle: Cycle) -> None:
        """Count this cycle's reads; report each servo once."""
        inputs = cycle.inputs
        self._lost_ns += sum(inputs.lost_ns.values())
        for sample in inputs.servos:
            self._reads += 1
            if sample.status.count(Status.OK) < len(SERVOS):
                for j, status in enumerate(sample.status):
                    self._lost[j] += status is not Status.OK
        if self._began_ns is None:
            self._began_ns = inputs.t_ns
        if inputs.t_ns - self._began_ns >= _WINDOW_NS:
            if self._lost_ns <= _LOST_NS:
                self._judge(inputs, cycle.events)
            self._began_ns, self._reads, self._lost = inputs.t_ns, 0, [0] * len(SERVOS)
            self._lost_ns = 0

    def _judge(self, inputs: Inputs, events: list[Event]) -> None:
        """Report who misses most: one that breaks off a reply loses those behind it, too, now and then."""
        most, least = max(self._lost), _SHARE * max(self._reads, _FEWEST_READS)
        found = {j for j, lost in enumerate(self._lost) if lost > least and 2 * lost > most}
        if not found <= self._told:
            self._told |= found
            who = ", ".join(self._names[j] for j in sorted(found))
            who = "all eight" if len(found) == len(SERVOS) else who
            said = f"{who}: {most} of {self._reads} reads are lost"
            events.append(Event(inputs.t_ns, "warning", "servos", said))
