"""Checks rate and delay of a sensor's samples: reports late, lost or slow samples.

A single lost packet is ignored; a larger share is reported once until it ends. Deterministic: depends only on
the inputs since `reset`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.signals import Event, Inputs, Status, samples_of, worst
from hil.loop.cycle_data import Check, Cycle

_OK = Status.OK
_WINDOW_NS = 1_000_000_000
_NEVER_NS = 1 << 62
HOST_SHARE = 0.85
"""Required share of a healthy sensor's samples: a busy host loses some by itself."""
_PUNCTUAL = 0.97
_LOST_NS = nanoseconds(0.03)
"""Time of a window that this computer may lose; a window in which it lost more is not evaluated."""
_SETTLED_NS = 700_000_000
"""Settling time after the first good sample: a camera's confidence is lower until then."""


@dataclass(frozen=True)
class Healthy:
    """Rates and delays of a healthy sensor of a kind.

    Attributes:
        rate_hz: samples per second; NaN where the rate is set outside the bench file.
        delivered: smallest share of good samples.
        age_s: largest age of a sample when it is read.
        loop_hz: rate at which the sensor is read. A second in which the loop itself was late is not
            evaluated.
    """

    rate_hz: float
    delivered: float
    age_s: float
    loop_hz: float


class _Stream:
    """Counts of one sensor in the present time window."""

    def __init__(self, name: str, healthy: Healthy) -> None:
        self.name, self.healthy, self.among = name, healthy, samples_of(name)
        self.punctual = _PUNCTUAL * healthy.loop_hz
        self.settled_ns = _NEVER_NS
        self.learns = math.isnan(healthy.rate_hz)
        self.most = 0.0 if self.learns else healthy.rate_hz * _WINDOW_NS / NS_PER_S
        self.sparse = self.late = False
        self.begin(_NEVER_NS)

    def begin(self, t_ns: int) -> None:
        """Begin a new window."""
        self.good, self.cycles, self.lost_ns, self.ends_ns = 0, 0, 0, t_ns + _WINDOW_NS
        self.youngest_ns = _NEVER_NS


class SensorRate(Check):
    """Checks the sample streams of one run.

    Args:
        healthy: expected rate and delay, by sensor.
    """

    def __init__(self, healthy: Mapping[str, Healthy]) -> None:
        self._healthy = healthy
        self.reset()

    def reset(self) -> None:
        """Clear the counts."""
        self._streams = [_Stream(name, healthy) for name, healthy in self._healthy.items()]

    def on_samples(self, cycle: Cycle) -> None:
        """Check rates and delays of this cycle's samples."""
        self.judge(cycle.inputs, cycle.events)

    def judge(self, inputs: Inputs, events: list[Event]) -> None:
        """Check one cycle's samples; adds findings to `events`."""
        t_ns, lost_ns = inputs.t_ns, sum(inputs.lost_ns.values())
        for stream in self._streams:
            for sample in stream.among(inputs):
                if sample.status is _OK or worst(sample) is _OK:
                    age_ns = t_ns - sample.stamp.t_ns
                    if t_ns >= stream.settled_ns:
                        stream.good += 1
                        if age_ns < stream.youngest_ns:
                            stream.youngest_ns = age_ns
                    elif stream.settled_ns == _NEVER_NS:
                        stream.settled_ns = t_ns + _SETTLED_NS
                        stream.begin(stream.settled_ns)
            stream.cycles += 1
            stream.lost_ns += lost_ns
            if t_ns >= stream.ends_ns:
                if stream.cycles >= stream.punctual and stream.lost_ns <= _LOST_NS:
                    self._conclude(stream, t_ns, events)
                stream.begin(t_ns)

    def _conclude(self, stream: _Stream, t_ns: int, events: list[Event]) -> None:
        """Evaluate a window at its end."""
        name, healthy = stream.name, stream.healthy
        sparse = stream.good < HOST_SHARE * healthy.delivered * stream.most
        late = stream.good > 0 and stream.youngest_ns > nanoseconds(healthy.age_s)
        if sparse and not stream.sparse and stream.good:
            said = f"sends {stream.good} good samples a second instead of {stream.most:.0f}"
            events.append(Event(t_ns, "warning", name, said))
        if late and not stream.late:
            said = f"its samples are {stream.youngest_ns / NS_PER_S:.3f} s old or more when they arrive"
            events.append(Event(t_ns, "warning", name, said))
        stream.sparse, stream.late = sparse, late
        if stream.learns:
            stream.most = max(stream.most, stream.good)
