"""Driver of the four steering encoders: drains CAN frames and combines them to sample sets with a status."""

import logging
from collections import deque
from collections.abc import Mapping

import can
import numpy as np

from hil.config.encoders import EncodersConfig
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import EncoderSample, Stamp
from hil.drivers.encoders.as5045.frame_layout import NODE_TIME, FrameLayout, load_layout
from hil.drivers.encoders.as5045.node_status import NodeStatus, NodeTimeline
from hil.drivers.encoders.as5045.word import decode_words
from hil.links.can_bus import CanLink, frame_key, remedy_of_silence, shown_key
from hil.streams.streaming_sensor import StreamingSensor

_EVERY_NS = NS_PER_S
_LOG = logging.getLogger(__name__)
_array = np.array  # a name of this module: looking it up in numpy takes longer
_WAIT_S = 0.02
_OVER_NS = 100_000_000
"""A set ends so long after its first frame, even without all frames; longer where sets are rarer."""
_OPEN_SETS = 3
_MOST_LISTED = 8
_OTHER_PACE = 1.25
"""Ratio from which two clocks do not count in one unit; frames that wait for the bus cost a tenth."""
_OFTEN, _TOGETHER_NS = 4, 1_000_000_000
"""So many clock jumps within so long mean two nodes: one cannot restart in a quarter of a second."""


class RateLimitedWarning:
    """Logs one kind of warning, at most once a second.

    Args:
        log: destination of the warnings.
    """

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._written_ns: int | None = None
        self._skipped = 0

    def warn(self, now_ns: int, message: str) -> None:
        """Log a message, or count it if one was logged less than a second ago; the next one has the count."""
        if self._written_ns is not None and 0 <= now_ns - self._written_ns < _EVERY_NS:
            self._skipped += 1
            return
        also = f" ({self._skipped} times more since the last message)" if self._skipped else ""
        self._log.warning("%s%s", message, also)
        self._written_ns, self._skipped = now_ns, 0


class As5045Encoders(StreamingSensor[EncodersConfig, EncoderSample]):
    """Four AS5045 behind one CAN node, whose link opens a failed bus again by itself.

    Args:
        config: python-can interface, DBC, signals.
        clock: the bench clock.

    Attributes:
        malformed: frames of the right identifier and the wrong length since `open`.
        incomplete: sample sets that lacked a frame since `open`.
        passed_over: frames of no use since `open`: of others, malformed, repeated.
        restarted: times (ns) of the latest jumps of the node's clock: a restart, or a second node.
        node_status: the node's status message, known within about a second of `open`.
    """

    name, what = "encoders", "sample set"

    def __init__(self, config: EncodersConfig, clock: Clock) -> None:
        super().__init__(config, clock)
        self._link = CanLink(self.name, config, clock, self._is_own)
        self._resumed_at = 0
        self._timeline = NodeTimeline(1, 1, 1.0)
        self._yellow_mode = config.yellow_mode
        self._over_ns = max(_OVER_NS, self.period_ns)
        self._forget()

    def _forget(self) -> None:
        self.malformed = self.incomplete = self.passed_over = 0
        self.restarted: deque[int] = deque(maxlen=_OFTEN)
        self._say_restarted, self._say_malformed = RateLimitedWarning(_LOG), RateLimitedWarning(_LOG)

    @property
    def place(self) -> str:
        """Interface and channel, for messages."""
        return self._link.port

    def open(self) -> None:
        """Load the DBC, open the bus and wait for complete sample sets.

        Raises:
            DataError: the DBC cannot be used.
            DeviceTimeoutError: the bus is silent.
            DeviceError: the bus cannot be opened, or what it carries does not match the DBC.
        """
        self._resumed_at = self._timeline.sequence = 0
        super().open()

    def _connect(self) -> Mapping[str, str]:
        self._resumed_at = max(self._resumed_at, self._timeline.sequence)
        self._layout = load_layout(self.config)
        self.node_status = NodeStatus(self.config)
        first = next(iter(self._layout.values()))
        self._timeline = NodeTimeline(first.sequence.mask, first.time.mask, first.time_lsb_s)
        self._forget()
        self._layout_reported = False
        self._set: int | None = None
        self._finished = -1
        self._words = [-1] * 4
        self._time_raw = 0
        self._discard = self.config.startup_discard
        self._link.open()
        self._await_first_set()
        self._timeline.sequence = max(self._resumed_at, self._timeline.sequence)  # goes on after an outage
        self._link.error = ""
        frames = ", ".join(f"{shown_key(i)} {f.name}" for i, f in self._layout.items())
        return {"model": "AS5045", "dbc": str(self.config.dbc_path), "frames": frames}

    def _disconnect(self) -> None:
        self._link.close()

    def identity(self) -> Mapping[str, str]:
        """Bus, DBC and frames in use, and the node's firmware once it has reported it; empty while closed."""
        if not self._identity or not self.node_status.heard:
            return self._identity
        return {**self._identity, "firmware": self.node_status.firmware}

    @property
    def error_frames(self) -> int:
        """Error frames seen on the bus since `open`."""
        return self._link.error_frames

    @property
    def bus_error(self) -> str:
        """What the CAN interface reported last (bus off, lost interface); empty for nothing."""
        return self._link.error

    @property
    def wrong_unit(self) -> str:
        """Message that the unit of the node's clock in the DBC does not fit its pace; empty for none."""
        pace = self._timeline.pace
        if 1.0 / _OTHER_PACE < pace < _OTHER_PACE:
            return ""
        unit_s = next(iter(self._layout.values())).time_lsb_s
        fits = f": a factor of {unit_s / pace:.2g} s fits" if pace > 0.0 else ""
        return f"by {NODE_TIME} the node's clock runs {pace:.3g} times as fast as this computer's{fits}"

    @property
    def two_nodes(self) -> str:
        """Message that a second node seems to send with our identifiers; empty for none."""
        if self.wrong_unit:
            return ""
        often = len(self.restarted) == _OFTEN and self.restarted[-1] - self.restarted[0] < _TOGETHER_NS
        identifiers = ", ".join(map(shown_key, self._layout))
        return (
            f"two nodes with one identifier: the counters of {identifiers} leap back and forth"
            if often
            else ""
        )

    def _take(self, now_ns: int) -> list[tuple[EncoderSample, int]]:
        """Sample sets of the frames that wait; a bounded number, as any node on the bus may send."""
        taken = [self._frame(message, arrived_ns, now_ns) for arrived_ns, message in self._link.take()]
        if self._set is not None and now_ns - self._arrival_ns > self._over_ns:
            taken.append(self._cut_short(now_ns))
        found = [(sample, now_ns) for sample in taken if sample is not None]
        if found:
            self._link.error = ""
        return found

    def sample(self, item: EncoderSample, stamp: Stamp) -> EncoderSample:
        """The sample set itself: its time and number are the node's."""
        return item

    def _is_own(self, key: int) -> bool:
        return key in self._layout or key == self.node_status.key

    def silent(self, what: str) -> DeviceTimeoutError:
        """The error of a silent node, with what was seen of the bus."""
        clocks = self.wrong_unit or self.two_nodes
        return DeviceTimeoutError(
            self.name,
            what + self._link.bus_errors() + f"; {clocks}" * bool(clocks),
            port=self.place,
            expected=f"{self.config.rate_hz:g} sets per second",
            remedy=f"correct the factor of {NODE_TIME} in encoders.dbc"
            if self.wrong_unit
            else remedy_of_silence(self.name, self.config, "the encoders' node"),
        )

    def _await_first_set(self) -> None:
        """Wait for complete sets; raises `DeviceError` that names what was seen instead."""
        deadline_ns = self.clock.now_ns() + nanoseconds(self.config.open_timeout_s)
        sets_left = _OPEN_SETS
        others: dict[int, int] = {}
        wrong: dict[int, int] = {}
        while self.clock.now_ns() < deadline_ns:
            for arrived_ns, message in self._link.take(_WAIT_S):
                key = frame_key(message.arbitration_id, message.is_extended_id)
                layout = self._layout.get(key)
                if layout is None:
                    others[key] = message.dlc
                elif len(message.data) != layout.length:
                    wrong[key] = len(message.data)
                self._frame(message, arrived_ns, self.clock.now_ns())
                if layout is not None and self._finished >= 0 and -1 not in self._words:
                    sets_left -= 1
            if sets_left <= 0:
                return
        raise self._not_seen(others, wrong)

    def _not_seen(self, others: Mapping[int, int], wrong: Mapping[int, int]) -> DeviceError:
        expected = ", ".join(f"{shown_key(i)} with {f.length} bytes" for i, f in self._layout.items())
        if wrong or others:
            seen = list((wrong or others).items())[:_MOST_LISTED]
            return DeviceError(
                self.name,
                "the frames do not match the DBC: seen "
                + ", ".join(f"{shown_key(i)} with {n} bytes" for i, n in seen),
                port=self.place,
                expected=expected,
                remedy="check encoders.dbc and encoders.node_id",
            )
        return self.silent(f"no {self.what} for {self.config.open_timeout_s:.1f} s")

    def _frame(self, message: can.Message, arrived_ns: int, host_ns: int) -> EncoderSample | None:
        """Process one frame; returns the sample set that it completes or cuts short."""
        layout = self._layout.get(frame_key(message.arbitration_id, message.is_extended_id))
        data = message.data
        if layout is None or len(data) != layout.length:
            self._pass_over(message, layout, host_ns)
            return None
        sequence, time_raw, words = layout.decode(data)
        if sequence == self._finished or not words:
            self.passed_over += 1
            return None
        sample = None
        if sequence != self._set:
            if self._set is not None:
                sample = self._cut_short(host_ns)
            self._set, self._arrival_ns, self._words = sequence, arrived_ns, [-1] * 4
        known = self._words
        for wheel, word in words:
            known[wheel] = word
        self._time_raw = time_raw
        return sample if -1 in known else self._finish(host_ns)

    def _warn_of_layout(self) -> None:
        if not self._layout_reported and (other := self.node_status.other_layout):
            self._layout_reported = True
            _LOG.warning("%s at %s sends %s", self.name, self.place, other)

    def _pass_over(self, message: can.Message, layout: FrameLayout | None, host_ns: int) -> None:
        """Process a frame without words of ours: the node's status, or one of no use."""
        if self.node_status.take(message):
            self._warn_of_layout()
            return
        self.passed_over += 1
        if layout is not None:
            self.malformed += 1
            text = f"frame {shown_key(layout.key)} has {len(message.data)} bytes, not {layout.length}"
            self._say_malformed.warn(host_ns, f"{self.name} at {self.place}: {text}")

    def _cut_short(self, host_ns: int) -> EncoderSample | None:
        """The sample of a set that lacks frames; else as `_finish`."""
        self.incomplete += 1
        return self._finish(host_ns)

    def _finish(self, host_ns: int) -> EncoderSample | None:
        """The sample of the present set; None while start-up garbage is dropped."""
        assert self._set is not None
        self._finished, words = self._set, self._words
        self._set = None
        t_ns, node_ns, restarted = self._timeline.update(self._finished, self._time_raw, self._arrival_ns)
        if restarted:
            self._discard = self.config.startup_discard
            self.restarted.append(host_ns)
            message = self.wrong_unit or self.two_nodes or "has restarted"
            self._say_restarted.warn(host_ns, f"{self.name} at {self.place}: {message}")
        if self._discard > 0:
            self._discard -= 1
            return None
        angles, status = decode_words(words, yellow_mode=self._yellow_mode)
        return EncoderSample(
            Stamp(t_ns, host_ns, self._timeline.sequence, node_ns), _array(angles), status, tuple(words)
        )
