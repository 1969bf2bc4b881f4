"""Puts a node's wrapping clock and counter on the bench's time axis.

The transport only ever delays, so the smallest difference of host time and node time seen so far is
the best estimate of their offset; it is let go by 200 ppm so that a slow node clock is followed. When a
prompt frame shows that earlier ones were late, times go on from where they are instead of backwards.
"""

from __future__ import annotations

from hil.core.clock import NS_PER_S

_LEAK = 200e-6
_RESTART_NS = 250_000_000


class NodeTimeline:
    """Unwraps sequence and node time of one node and maps them to the bench clock."""

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

    def update(self, sequence: int, time_raw: int, host_ns: int) -> tuple[int, int, bool]:
        """One sample set arrived at `host_ns`.

        Returns:
            (bench time of measurement ns, node time unwrapped ns, whether the node has restarted).
        """
        if not self._started:
            self._start(sequence, time_raw, host_ns)
            return self._forward(host_ns, host_ns), self._node_ns, False
        elapsed_ns = host_ns - self._host_ns
        node_step_ns = round((time_raw - self._time_raw) % self._wrap * self._lsb_ns)
        behind_ns = elapsed_ns - node_step_ns
        if behind_ns >= self._half_ns or behind_ns <= -self._half_ns:
            node_step_ns += round(behind_ns / self._wrap_ns) * self._wrap_ns
        step = (sequence - self._sequence_raw) & self._sequence_mask
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
