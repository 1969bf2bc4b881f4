"""The device under check, the samples that it delivered, and the error of a broken contract."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hil.bench.bench import Bench
from hil.bench.device_set_from_config import model_of
from hil.config.bench import BenchConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import Aborted, HilError
from hil.core.finding import Finding
from hil.core.registry import kinds

WATCH_S, SHORT_S = 1.0, 0.2
SHARE = 0.7
"""Required share of the due samples: some may be lost because of this computer's load."""
_OLDER = 5.0


class Broken(AssertionError):
    """A device breaks its contract.

    Args:
        found, expected, remedy: finding, expectation and remedy, in words.
    """

    def __init__(self, found: str, expected: str, remedy: str = "") -> None:
        super().__init__("; ".join(filter(None, (found, f"expected {expected}", remedy))))
        self.found, self.expected, self.remedy = found, expected, remedy


@dataclass(frozen=True)
class Delivered:
    """Data from a device while it was open: samples, identity, and durations of the reads.

    Attributes:
        samples: samples, the oldest first.
        identity: identity that the device reports.
        began_ns, ended_ns: bench time.
        took_s: duration of each read.
    """

    samples: list[Any]
    identity: Mapping[str, str]
    began_ns: int
    ended_ns: int
    took_s: list[float]


@dataclass(frozen=True)
class Subject:
    """One closed device of a bench whose world runs.

    Attributes:
        bench: bench of the device.
        kind: the device's kind.
        anew: function that makes the same bench again, from its beginning; None if a run cannot be repeated,
            because a part of it runs in real time.
    """

    bench: Bench
    kind: str
    anew: Callable[[], Bench] | None = None

    @property
    def device(self) -> Any:
        """The driver of the device."""
        return self.bench.devices.get(self.kind)

    @property
    def not_measured(self) -> tuple[str, ...]:
        """Fields of the samples that the device's model does not measure."""
        return model_of(self.bench.config, self.kind).not_measured

    @contextmanager
    def opened(self) -> Iterator[Any]:
        """Open the driver for the duration of the block."""
        device = self.device
        device.open()
        try:
            yield device
        finally:
            device.close()

    @cached_property
    def watched(self) -> Delivered:
        """Open the device, read it for a second and close it; the data are shared by all checks."""
        with self.opened() as device:
            began_ns, took_s = self.bench.clock.now_ns(), list[float]()
            samples = read_for(self.bench, device, WATCH_S, took_s)
            identity = dict(device.identity())  # read now: some report firmware in samples
            return Delivered(samples, identity, began_ns, self.bench.clock.now_ns(), took_s)


def read_for(bench: Bench, device: Any, duration_s: float, took_s: list[float] | None = None) -> list[Any]:
    """Read a device at the loop rate and return all samples; `took_s` receives each read's duration."""
    clock, period_ns = bench.clock, nanoseconds(1.0 / bench.config.loop.rate_hz)
    samples, next_ns = list[Any](), clock.now_ns()
    for _ in range(round(duration_s * bench.config.loop.rate_hz)):
        began_ns = clock.now_ns()
        samples += device.read()
        if took_s is not None:
            took_s.append((clock.now_ns() - began_ns) / NS_PER_S)
        next_ns += period_ns
        clock.sleep_until_ns(next_ns)
    return samples


def due(bench: Bench, kind: str, samples: list[Any], duration_s: float) -> float:
    """Expected number of samples of a healthy device; without a nominal rate, by their median period."""
    rate_hz = kinds()[kind].rate_hz(bench.config.devices()[kind], bench.config.loop.rate_hz)
    if np.isnan(rate_hz):
        times_ns = np.unique([s.stamp.t_ns for s in samples])
        period_ns = np.median(np.diff(times_ns)) if len(times_ns) > 2 else np.inf
        return duration_s / (1e-9 * float(period_ns))
    return duration_s * rate_hz


def oldest_s(config: BenchConfig, kind: str) -> float:
    """Largest age of a healthy device's samples, s; one cycle more if they wait for the loop."""
    waits = config.devices()[kind].waits_for_loop()
    return _OLDER * kinds()[kind].max_age_s + waits / config.loop.rate_hz


def judged(device: str, promise: str, check: Callable[[], str]) -> Finding:
    """Run one check; the finding is ok with the measured values, or a failure with the raised error.

    Raises:
        Aborted: a person or a signal ended the check.
    """
    try:
        return Finding(device, promise, "ok", check())
    except Broken as broken:
        return Finding(device, promise, "failure", broken.found, broken.expected, broken.remedy)
    except Aborted:
        raise
    except HilError as error:
        return Finding(device, promise, "failure", error.message, error.expected, error.remedy)
