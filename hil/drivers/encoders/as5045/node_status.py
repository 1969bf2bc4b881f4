"""Clock, sequence counter and status message of the encoder node.

The clock wraps, and is mapped to the bench clock. The transport only ever delays, so the smallest
difference of host time and node time seen so far is the best estimate of their offset. It rises by 200 ppm
to follow a slow node clock. When a prompt frame shows that earlier ones were late, times do not go back.
The status message comes once a second and holds firmware, frame layout and counters.
"""

from typing import Any

import can

from hil.config.encoders import EncodersConfig
from hil.core.clock import NS_PER_S
from hil.links.can_bus import frame_key
from hil.links.dbc_file import key_of_message, load_database

_LEAK = 200e-6
_RESTART_NS = 250_000_000
_PACE_NS, _STEADY = 250_000_000, 0.3
"""Time over which the node's clock is compared with the host's, and share by which its steps may differ then:
those of two nodes that take turns differ by more."""
_MESSAGE, _LAYOUT = "NodeStatus", "Layout"
_COUNTERS = {
    "ParityErrors": "words with wrong parity",
    "LateSets": "late sample sets",
    "UnsentFrames": "frames that the bus did not take",
    "TimesOffBus": "times off the bus",
}


class NodeTimeline:
    """Unwraps sequence and node time of one node and maps them to the bench clock.

    Attributes:
        sequence: number of the latest sample set, unwrapped.
        pace: speed of the node's clock over that of the host, by its latest steady steps; 1 before them.
    """

    def __init__(self, sequence_mask: int, time_mask: int, time_lsb_s: float) -> None:
        self._sequence_mask = sequence_mask
        self._lsb_ns = time_lsb_s * NS_PER_S
        self._wrap = time_mask + 1
        self._wrap_ns = round(self._wrap * self._lsb_ns)
        self._half_ns = self._wrap_ns // 2
        self._started = False
        self._sequence_raw = self._time_raw = self._host_ns = self._node_ns = 0
        self._offset_ns = 0.0
        self._t_ns = -(1 << 62)
        self.sequence = 0
        self.pace = 1.0
        self._ticks = self._lasted_ns = 0
        self._ticks_per_set = 0.0

    def update(self, sequence: int, time_raw: int, host_ns: int) -> tuple[int, int, bool]:
        """Map the times of a sample set that arrived at `host_ns`.

        Returns:
            (bench time of measurement ns, node time unwrapped ns, whether the node has restarted).
        """
        if not self._started:
            self._start(sequence, time_raw, host_ns)
            return self._forward(host_ns, host_ns), self._node_ns, False
        elapsed_ns = host_ns - self._host_ns
        ticks, step = (
            (time_raw - self._time_raw) % self._wrap,
            (sequence - self._sequence_raw) & self._sequence_mask,
        )
        self._compare(ticks, step, elapsed_ns)
        node_step_ns = round(ticks * self._lsb_ns)
        behind_ns = elapsed_ns - node_step_ns
        if behind_ns >= self._half_ns or behind_ns <= -self._half_ns:
            node_step_ns += round(behind_ns / self._wrap_ns) * self._wrap_ns
        if abs(node_step_ns - elapsed_ns) > _RESTART_NS or node_step_ns < 0:
            before = self.sequence
            self._start(sequence, time_raw, host_ns)
            self.sequence = before + 1
            return self._forward(host_ns, host_ns), self._node_ns, True
        self.sequence += step
        self._sequence_raw, self._time_raw, self._host_ns = sequence, time_raw, host_ns
        self._node_ns += node_step_ns
        leaked_ns = self._offset_ns + _LEAK * elapsed_ns
        offset_ns = host_ns - self._node_ns
        self._offset_ns = leaked_ns if leaked_ns < offset_ns else offset_ns
        t_ns = self._forward(round(self._node_ns + self._offset_ns), host_ns)
        return t_ns, self._node_ns, False

    def _compare(self, ticks: int, step: int, elapsed_ns: int) -> None:
        """Add `step` sample sets, `ticks` of the node's clock later; one that does not follow begins anew."""
        usual = self._ticks_per_set
        if step and elapsed_ns > 0 and abs(ticks - step * usual) <= _STEADY * step * usual:
            self._ticks += ticks
            self._lasted_ns += elapsed_ns
        else:
            self._ticks_per_set = ticks / step if step else 0.0
            self._ticks = self._lasted_ns = 0
        if self._lasted_ns >= _PACE_NS:
            self.pace = self._ticks * self._lsb_ns / self._lasted_ns
            self._ticks = self._lasted_ns = 0

    def _forward(self, t_ns: int, host_ns: int) -> int:
        t_ns = t_ns if t_ns < host_ns else host_ns
        self._t_ns = t_ns if t_ns > self._t_ns else self._t_ns + 1
        return self._t_ns

    def _start(self, sequence: int, time_raw: int, host_ns: int) -> None:
        self._started = True
        self.sequence = self._sequence_raw = sequence
        self._time_raw, self._host_ns = time_raw, host_ns
        self._node_ns = round(time_raw * self._lsb_ns)
        self._offset_ns = host_ns - self._node_ns


class NodeStatus:
    """The latest status frame of a node, read by the DBC.

    Args:
        config: DBC and address of the node; a DBC need not describe a status frame.

    Attributes:
        heard: True once a status frame has come.
        key: identifier of the status frame (`frame_key`); -1 for none.
        counted: errors that the node has counted since its first status frame, in words.

    Raises:
        DataError: the DBC cannot be read.
    """

    def __init__(self, config: EncodersConfig) -> None:
        found = [m for m in load_database(config.dbc_path).messages if m.name == _MESSAGE]
        self._message: Any = found[0] if found else None
        self.key = key_of_message(found[0], config.node_id, config.dbc_path) if found else -1
        self._first: dict[str, int] = {}
        self._latest: dict[str, int] = {}

    def take(self, message: can.Message) -> bool:
        """Use a frame if it is the node's status; returns whether it is."""
        key = frame_key(message.arbitration_id, message.is_extended_id)
        if key != self.key or message.is_remote_frame or message.is_error_frame:
            return False
        if message.dlc == self._message.length:
            self._latest = self._message.decode(bytes(message.data), decode_choices=False)
            self._first = self._first or self._latest
        return True

    @property
    def heard(self) -> bool:
        """Whether a status frame has come."""
        return bool(self._latest)

    @property
    def firmware(self) -> str:
        """Firmware version of the node; `?` where it is not reported."""
        return str(self._latest.get("Firmware", "?"))

    @property
    def rate_hz(self) -> float:
        """Sample sets per second that the node was built for; 0 where that is not reported."""
        return float(self._latest.get("Rate", 0))

    @property
    def other_layout(self) -> str:
        """How the node's frames differ from the DBC; empty where they agree or no layout is reported."""
        if not self._latest or _LAYOUT not in self._latest:
            return ""
        known = next(s for s in self._message.signals if s.name == _LAYOUT).choices or {}
        theirs = self._latest[_LAYOUT]
        if not known or theirs in known:
            return ""
        return f"frames of layout {theirs}, the DBC describes {', '.join(str(k) for k in known)}"

    @property
    def counted(self) -> str:
        """Errors that the node has counted since its first status frame, in words; empty for none."""
        steps = {k: (self._latest[k] - self._first[k]) % 256 for k in _COUNTERS if k in self._latest}
        return ", ".join(f"{n} {_COUNTERS[k]}" for k, n in steps.items() if n)

    def __str__(self) -> str:
        """Firmware and cause of the last reset, in words."""
        if not self._latest:
            return "the node does not say"
        causes = next((s.choices for s in self._message.signals if s.name == "ResetCause"), None) or {}
        cause = causes.get(self._latest.get("ResetCause", -1), "unknown")
        return f"firmware {self.firmware}, started by {cause}"
