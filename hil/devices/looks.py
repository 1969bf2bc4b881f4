"""What `hil doctor` asks of a device that it has watched for a while, and what most devices are asked."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from hil.vocabulary.clock import Clock
from hil.vocabulary.finding import Finding, Level
from hil.vocabulary.kinds import DeviceKind
from hil.vocabulary.signals import Status, worst

LOSS_WARNING, LOSS_FAILURE = 0.02, 0.2


@dataclass(frozen=True)
class Watched:
    """A device that was read at the loop rate for a while.

    Attributes:
        kind: of the device.
        config: its table of the bench file.
        device: its driver, open.
        samples: what it delivered.
        watch_s: for how long it was read.
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
    def due(self) -> int:
        """Samples that a healthy device would have delivered; as many as came where its rate is open."""
        rate_hz = self.kind.rate_hz(self.config, self.loop_hz)
        return len(self.samples) if math.isnan(rate_hz) else max(1, round(self.watch_s * rate_hz))


def losses(name: str, statuses: Iterable[Status], due: int, remedy: str) -> Finding:
    """How many of the samples that were due are good, and what the others lack.

    Args:
        name: of the device.
        statuses: one for each sample.
        due: how many there should be.
        remedy: what to do when many are missing.
    """
    seen = Counter(statuses)
    good = seen.pop(Status.OK, 0)
    seen.pop(Status.STARTING, None)
    loss = 1.0 - good / due if due else 1.0
    level: Level = "failure" if loss > LOSS_FAILURE else "warning" if loss > LOSS_WARNING else "ok"
    told = ", ".join(f"{count} {status.value}" for status, count in seen.most_common()) or "no bad samples"
    return Finding(name, "samples", level, f"{good} of {due} good ({told})", "nearly all good", remedy)


def samples_look(remedy: str) -> Callable[[Watched], Iterator[Finding]]:
    """A look that counts good samples, for a kind that has nothing else to be asked."""

    def look(watched: Watched) -> Iterator[Finding]:
        statuses = (worst(sample) for sample in watched.samples)
        yield losses(watched.kind.name, statuses, watched.due, remedy)

    return look
