"""A device as `hil doctor` has watched it, and the findings that most devices share."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from hil.core.clock import Clock
from hil.core.device import DeviceKind
from hil.core.finding import Finding, Level
from hil.core.signals import Status, worst

LOSS_WARNING, LOSS_FAILURE = 0.02, 0.2
SUPPLY = "check its supply and cable"
"""Remedy for a device that restarts."""
_STUCK = (
    "its samples arrive, so cable and rate are right, but they repeat the same values: switch its supply off "
    "and on; if that does not help, the device is defective"
)
MORE_WARNING, MORE_FAILURE = 0.05, 0.2
"""Share of samples beyond those that are due: data sheets let the rate of MEMS sensors be off by up to 3 %;
clocks and their adjustment are off by less than 0.1 %."""
_AT_THE_ENDS = 2
"""Samples beyond that share that a short watch may have, one at each end."""
_NO_MORE = f"at most {MORE_WARNING:.0%} more than the rate allows"
_WHY_MORE = "set the device to the rate of the bench file, or fix a driver that delivers samples twice"


@dataclass(frozen=True)
class Watched:
    """A device that was read at the loop rate for a while.

    Attributes:
        kind: kind of the device.
        config: its table of the bench file.
        device: its driver, open.
        samples: samples that it delivered.
        watch_s: time for which it was read.
        clock: the bench clock.
        loop_hz: loop rate.
    """

    kind: DeviceKind
    config: Any
    device: Any
    samples: Sequence[Any]
    watch_s: float
    clock: Clock
    loop_hz: float

    @property
    def not_measured(self) -> tuple[str, ...]:
        """Fields of the sample that its model does not measure."""
        return self.kind.model(self.config.model).not_measured

    @property
    def due(self) -> int:
        """Samples that a healthy device delivers; the number received where its rate is not known."""
        rate_hz = self.kind.rate_hz(self.config, self.loop_hz)
        return len(self.samples) if math.isnan(rate_hz) else max(1, round(self.watch_s * rate_hz))

    def losses(self, remedy: str, but: Sequence[Status] = ()) -> Iterator[Finding]:
        """How many of the samples that were due are good; `remedy` for when many are missing.

        A status in `but` counts as good: it describes the surroundings, not the device.
        """
        states = (Status.OK if (state := worst(s)) in but else state for s in self.samples)
        yield losses(self.kind.name, states, self.due, remedy)


def surplus(count: int, due: float) -> float:
    """Share of samples beyond those due; 0 or less where there are not too many.

    Args:
        count: number of all samples, good or bad.
        due: number that a healthy device delivers.
    """
    return (count - _AT_THE_ENDS) / due - 1.0 if due else 0.0


def losses(name: str, statuses: Iterable[Status], due: int, remedy: str) -> Finding:
    """How many of the samples that were due are good, the statuses of the others, and whether too many came.

    A device that restarts while it is watched is a failure, however many samples are good.

    Args:
        name: name of the device.
        statuses: status of each sample.
        due: number of samples that there should be.
        remedy: advice for when many are missing; where most of the bad ones repeat the same values, that is
            named instead.
    """
    seen = Counter(statuses)
    count, good = sum(seen.values()), seen.pop(Status.OK, 0)
    seen.pop(Status.STARTING, None)
    more = surplus(count, due)
    if more > MORE_WARNING:
        level: Level = "failure" if more > MORE_FAILURE else "warning"
        return Finding(name, "samples", level, f"{count} samples where {due} are due", _NO_MORE, _WHY_MORE)
    if again := restarted(seen[Status.RESET], count):
        return Finding(name, "samples", "failure", again, "none", SUPPLY)
    loss = 1.0 - good / due if due else 1.0
    level = "failure" if loss > LOSS_FAILURE else "warning" if loss > LOSS_WARNING else "ok"
    message = ", ".join(f"{count} {status.value}" for status, count in seen.most_common()) or "no bad samples"
    do = _STUCK if 2 * seen[Status.FROZEN] > due - good else remedy
    return Finding(name, "samples", level, f"{good} of {due} good ({message})", "nearly all good", do)


def restarted(again: int, count: int) -> str:
    """Message for `again` of `count` samples that report a restart; empty for none."""
    return f"{again} of {count} samples say that it has restarted" if again else ""
