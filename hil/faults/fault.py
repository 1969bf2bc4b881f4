"""One fault of a device: its kind, when it acts, its options, and how it is written.

All devices share one vocabulary of faults. A fault spec is written
`DEVICE:KIND[@START_S[+DURATION_S]][,key=value...]`, for example `imu:stuck@2+3`,
`servo.drive_FL:off@5`, `servos:drop@1+10,probability=0.1`. Without `@` it is active from the start,
without `+` until the end. A device declares the faults and options that it supports; others are rejected,
and so is an option outside its range.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import UsageError, did_you_mean

_SWITCH = (0, 1, True)
MEANINGS = {
    "off": "no power, or no server: silence; what comes back has started anew",
    "stuck": "the last value again and again, with fresh stamps and counters",
    "garbage": "random content in well-formed answers or frames",
    "wrong": "plausible values that are not true",
    "slow": "output at a lower rate, or late answers",
    "delayed": "values of some time ago",
    "intermittent": "silence for a part of every period",
    "silent": "nothing arrives, while the device goes on",
    "drop": "messages that are lost, at random",
    "corrupt": "messages with one damaged bit, at random",
    "truncate": "messages that end early, at random",
    "duplicate": "messages that come twice, at random",
    "pieces": "bytes of a message that arrive in pieces, with pauses between them",
    "baud_mismatch": "the line runs at another rate than the host",
    "bus_off": "the CAN controller has left the bus",
    "unplug": "cable or adapter gone; the port fails as a real one does; a T265 comes back only when it is "
    "opened again",
    "brownout": "supply below what the device needs; it starts anew afterwards",
    "reset": "starts anew, once",
    "jump": "a step, once: of a heading, an encoder or a pose; motion capture exchanges its two bodies",
    "adhesion_loss": "the fan presses less",
}
"""Every kind of fault, and what happens."""
VOCABULARY = tuple(MEANINGS)
_LARGEST, _BRIEFEST = 1e9, 0.001
Supported = Mapping[str, tuple[str, ...]]
"""Faults that a device can produce, and the options that each takes."""
PERIODIC = ("period_s", "duty")
_PART_OF = {"servo": "servos", "encoder": "encoders"}
"""Devices whose parts have faults of their own, by the first word of a part's name."""
IN, OUT, BOTH = WAYS = ("in", "out", "both")
"""Directions of a wire, seen from the bench: from the device, towards it."""
FACTOR, PERIOD_S, DUTY, PROBABILITY, DELAY_S = 5.0, 0.5, 0.5, 0.1, 0.1
"""Defaults of options; `docs/faults.md` lists them."""
_SPEC = re.compile(
    r"(?P<device>[\w.]+):(?P<kind>\w+)(?:@(?P<start>[\d.eE-]+)(?:\+(?P<duration>[\d.eE-]+))?)?"
    r"(?P<options>(?:,\w+=[^,]+)*)"
)


def _shortest(value: float) -> str:
    """Shortest text that is read as the same number."""
    return repr(float(value)).removesuffix(".0")


class Option(NamedTuple):
    """One option of a fault: meaning, smallest and largest value, and whether it is an integer.

    With `words` its values are written as one of these words, and kept as the word's index.
    """

    meaning: str
    least: float
    most: float
    whole: bool = False
    words: tuple[str, ...] = ()

    def value(self, written: float | str) -> float:
        """Return the value of a written one; raises `ValueError`."""
        return float(self.words.index(str(written))) if self.words else float(written)

    def text(self, value: float) -> str:
        """Return how a value is written."""
        return self.words[int(value)] if self.words else _shortest(value)

    @property
    def range(self) -> str:
        """Range of values, as text."""
        if self.words:
            return ", ".join(f"`{word}`" for word in self.words)
        return f"{'whole, ' if self.whole else ''}{self.least:.7g} to {self.most:.7g}"

    @property
    def expected(self) -> str:
        """Range of values, as text for an error message."""
        if self.words:
            return "one of " + ", ".join(self.words)
        return f"a {'whole ' if self.whole else ''}number from {self.least:.7g} to {self.most:.7g}"

    def takes(self, value: float) -> bool:
        """Return whether a value is in range; False for NaN."""
        return self.least <= value <= self.most and (not self.whole or value == int(value))


FINITE = Option("of a device of another package", -1e9, 1e9)
"""An option of another package's device: any finite number of moderate size."""

OPTIONS = {
    "angle_rad": Option("size of the error or step, rad", -10, 10),
    "announced": Option("1: the jump is announced by the reset counter; 0: it is not", *_SWITCH),
    "answer_s": Option("extra time before an answer, s", 0, 60),
    "clock": Option("1: random time stamps", *_SWITCH),
    "code": Option("error code answered instead of silence; 0: silence", 0, 255, True),
    "confidence": Option(
        "what the camera calls its poses, 0 failed to 3 high; the poses stay true", 0, 3, True
    ),
    "delay_s": Option("by how much, s", 0, 60),
    "direction": Option(
        "of the messages: `in` from the device, as without this option, `out` towards an emulated one",
        *(0, len(WAYS) - 1, True, WAYS),
    ),
    "distance_m": Option("size of the step, m", -100, 100),
    "duty": Option("part of every period that is silent", 0, 1),
    "drift_x_m_s": Option("motion along wall x that is seen and is none, m/s", -10, 10),
    "drift_y_m_s": Option("the same along wall y", -10, 10),
    "drift_n_s": Option(
        "how fast the reported force leaves the true one, N/s; `factor` then does nothing", -1000, 1000
    ),
    "slow:factor": Option("of the output period", 1, 1000),
    "wrong:factor": Option("of what is sent; of the force of propellers on a Teensy, from 0", -10, 10),
    "adhesion_loss:factor": Option("of the fan's force", 0, 1),
    "gap_s": Option("pause between two pieces, s", 0, 1),
    "flags": Option("status bits of the encoder chip to set, instead of random words", 0, 31, True),
    "force_n": Option("size of the step, N", -10_000, 10_000),
    "frame": Option("MAVLink number of the frame that poses claim", 0, 255, True),
    "nan": Option("1: NaN instead of random numbers", *_SWITCH),
    "occlude": Option("1: the body is out of sight; 0: no frame is sent", *_SWITCH),
    "offset_m": Option("along x, m", -100, 100),
    "offset_rad": Option("size of the error, rad", -10, 10),
    "over_s": Option("time in which the fan's force goes down along a line, s", 0, 3600),
    "packets": Option("1: random packets", *_SWITCH),
    "period_s": Option("length of a period, s", 0.001, 3600),
    "probability": Option("of each message", 1e-6, 1),
    "quality": Option("what the computer calls its poses; the poses stay true", -1, 100, True),
    "rate_rad_s": Option("added to every axis of the gyroscope, rad/s", -100, 100),
    "share": Option(
        "of the motor's turns that reach the wheel: its hub slips; `angle_rad` then does nothing", 0.05, 1
    ),
    "size": Option("mean bytes of a piece", 1, 4096, True),
    "speed_rpm": Option("size of the step of the reported speed, 1/min", -200_000, 200_000),
    "steps": Option("of the throttle's 180 steps, added once", -180, 180, True),
    "scale": Option("factor on every step seen", -10, 10),
}
"""Options by name, or by `KIND:NAME` if the meaning depends on the kind of fault."""


def option_of(kind: str, name: str) -> Option:
    """Return the description of an option for a kind of fault."""
    return OPTIONS.get(f"{kind}:{name}") or OPTIONS.get(name) or FINITE


@dataclass(frozen=True)
class Fault:
    """One fault on one device, active during [start_ns, end_ns) of world time.

    Raises:
        UsageError: an option outside its range (`hil.faults.fault`).
    """

    device: str
    kind: str
    start_ns: int = 0
    end_ns: int | None = None
    options: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in self.options:
            self.check(key, option_of(self.kind, key))

    def __str__(self) -> str:
        """Spec of the fault, which `parse_fault` can parse."""
        text = f"{self.device}:{self.kind}@{_shortest(self.start_ns / NS_PER_S)}"
        if self.end_ns is not None:
            text += f"+{_shortest((self.end_ns - self.start_ns) / NS_PER_S)}"
        written = {key: option_of(self.kind, key).text(value) for key, value in self.options.items()}
        return text + "".join(f",{key}={value}" for key, value in written.items())

    def check(self, key: str, option: Option) -> None:
        """Raise `UsageError` if the value of an option is out of range."""
        if not option.takes(self.options[key]):
            raise UsageError(
                f"fault {self}: {key} is {self.options[key]:g}",
                expected=f"{option.expected} ({option.meaning})",
            )

    @property
    def whole(self) -> str:
        """Name of the whole device: `servos` for a fault of `servo.drive_FL`."""
        first = self.device.partition(".")[0]
        return _PART_OF.get(first, first)

    def active(self, t_ns: int) -> bool:
        """Return whether the fault is active at `t_ns`."""
        return self.start_ns <= t_ns and (self.end_ns is None or t_ns < self.end_ns)

    def option(self, key: str, default: float) -> float:
        """Return the value of an option, or `default` if it is not given."""
        return self.options.get(key, default)

    def silences(self, t_ns: int) -> bool:
        """Return whether an `intermittent` fault silences the device: the last `duty` of each `period_s`."""
        period_ns = nanoseconds(self.option("period_s", PERIOD_S))
        return (t_ns - self.start_ns) % period_ns >= (1.0 - self.option("duty", DUTY)) * period_ns

    def strikes(self, way: str, default: str = IN) -> bool:
        """Return whether the fault acts on messages of a way (`IN` or `OUT`) of its wire.

        Args:
            way: the messages.
            default: the way on which the fault acts if its `direction` is not given.
        """
        direction = WAYS[int(self.option("direction", WAYS.index(default)))]
        return direction in (way, BOTH)

    def hits(self, rng: np.random.Generator) -> bool:
        """Draw whether the fault hits this packet, frame or reply, with its `probability`."""
        return bool(rng.random() < self.option("probability", PROBABILITY))

    @property
    def period_factor(self) -> float:
        """Factor by which a `slow` fault stretches a period."""
        return self.option("factor", FACTOR)

    def remaining_share(self, t_ns: int, left: float, over_s: float) -> float:
        """Share left of a quantity that falls linearly from 1 to `left` within `over_s` of the start."""
        over_ns = nanoseconds(over_s)
        passed = 1.0 if over_ns <= 0 else min((t_ns - self.start_ns) / over_ns, 1.0)
        return 1.0 + (left - 1.0) * passed

    def delay_ns(self, default_s: float = DELAY_S) -> int:
        """Latency of a `delayed` fault, ns."""
        return nanoseconds(self.option("delay_s", default_s))


def check_kind(what: str, kind: str) -> None:
    """Check that a word is a kind of fault.

    Args:
        what: first part of the error message.
        kind: word to check.

    Raises:
        UsageError: unknown kind; names the nearest one.
    """
    if kind not in MEANINGS:
        raise UsageError(
            what, expected="one of " + ", ".join(VOCABULARY), remedy=did_you_mean(kind, VOCABULARY)
        )


def make_fault(
    device: str, kind: str, /, *, at: float = 0.0, duration: float | None = None, **options: float | str
) -> Fault:
    """Make a fault from times in seconds; raises `UsageError` for an impossible time or option.

    `FaultPlan.check` checks whether the device exists and supports the fault.
    """
    if not 0 <= at <= _LARGEST or (duration is not None and not _BRIEFEST <= duration <= _LARGEST):
        lasts = "" if duration is None else f" and duration {duration:g} s"
        raise UsageError(
            f"fault {device}:{kind} has start {at:g} s{lasts}",
            expected=f"a start >= 0 and a duration of at least {_BRIEFEST:g} s, both at most {_LARGEST:g} s",
        )
    start = nanoseconds(at)
    end = None if duration is None else start + nanoseconds(duration)
    return Fault(device, kind, start, end, {k: _value(device, kind, k, v) for k, v in options.items()})


def _value(device: str, kind: str, key: str, written: float | str) -> float:
    option = option_of(kind, key)
    try:
        return option.value(written)
    except ValueError:
        raise UsageError(
            f"fault {device}:{kind}: {key} is {written!r}", expected=f"{option.expected} ({option.meaning})"
        ) from None


def parse_fault(spec: str) -> Fault:
    """Parse a fault spec from the command line; raises `UsageError` that shows the expected form."""
    match = _SPEC.fullmatch(spec.strip())
    try:
        if match is None:
            raise ValueError(spec)
        pairs = [item.split("=", 1) for item in match["options"].split(",") if item]
        return make_fault(
            match["device"],
            match["kind"],
            at=float(match["start"] or 0.0),
            duration=float(match["duration"]) if match["duration"] else None,
            **dict(pairs),
        )
    except UsageError:
        raise
    except (ValueError, TypeError):
        raise UsageError(
            f"fault {spec!r} cannot be read",
            expected="DEVICE:KIND[@START_S[+DURATION_S]][,key=number...], for example imu:stuck@2+3",
        ) from None
