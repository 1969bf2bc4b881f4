"""The state of a device's samples now: silent, bad, slow or ok, by the limits of its kind."""

import math
from dataclasses import dataclass

from hil.config.bench import BenchConfig
from hil.core.registry import kinds
from hil.core.signals import Status
from hil.core.third_party_errors import PackageError, call_in_package
from hil.loop.checks.sensor_rate import HOST_SHARE

SILENT, SLOW, NOTHING = "silent", "slow", "nothing yet"


@dataclass(frozen=True)
class StreamLimits:
    """Limits of one device.

    Attributes:
        due_hz: rate of a healthy device; None where it is not known.
        share: smallest share of that rate.
        silent_s: age of the newest sample from which on the device is silent.
    """

    due_hz: float | None
    share: float
    silent_s: float

    @classmethod
    def of(cls, name: str, config: BenchConfig) -> "StreamLimits":
        """The limits of a device of a bench."""
        kind, own, loop_hz = kinds()[name], config.devices()[name], config.loop.rate_hz
        try:
            rate_hz = call_in_package(name, kind.package, "rate_hz()", kind.rate_hz, own, loop_hz)
            stale_s = call_in_package(
                name, kind.package, "stale_after_s()", kind.stale_after_s, config.safety, own
            )
        except PackageError:  # a bench that asks for it names the package
            rate_hz, stale_s = math.nan, None
        gap_s = kind.max_gap_s if stale_s is None else min(kind.max_gap_s, stale_s)
        due_hz = rate_hz if math.isfinite(rate_hz) else None
        return cls(due_hz, HOST_SHARE * kind.min_delivered, gap_s + kind.max_age_s + 1.0 / loop_hz)

    def state(self, newest: Status | None, age_s: float, rate_hz: float, window_s: float) -> str:
        """The state in a word.

        Args:
            newest: status of the newest sample; None before the first.
            age_s: age of that sample, s.
            rate_hz: samples per second.
            window_s: time in which the rate was measured; one sample more or less in it counts for nothing.
        """
        if newest is None:
            return NOTHING
        if age_s > self.silent_s:
            return SILENT
        if newest is not Status.OK:
            return str(newest.value)
        due = 0.0 if self.due_hz is None else self.share * self.due_hz * window_s - 1.0
        return SLOW if rate_hz * window_s < due else str(Status.OK.value)
