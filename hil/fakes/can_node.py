"""A node on a CAN bus that sends unasked."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from hil.fakes.can_channel import WIRE_FAULTS, CanChannel
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.streaming_chip import COMMON_FAULTS, StreamingChip
from hil.fakes.world import NEVER_NS, Scheduled


class CanStreamingNode(StreamingChip, Scheduled):
    """A node on a CAN bus that sends the frames of its table's `FRAME_IDS`; give `measure` and `encode`."""

    announces = True

    def __init__(self, request: EmulationRequest, channel: CanChannel) -> None:
        super().__init__(request)
        self._channel = channel
        self.world.faults.declare(self.name, {**COMMON_FAULTS, **WIRE_FAULTS, **self.own_faults})
        self.world.add(self)

    @classmethod
    def build(cls, request: EmulationRequest, channel: CanChannel) -> CanStreamingNode:
        """The node of a table of the bench file."""
        return cls(request, channel)

    @abstractmethod
    def encode(self, measured: Any) -> Mapping[int, bytes]:
        """The frames of a measurement, by identifier."""

    def next_due_ns(self) -> int:
        """When the next measurement is due."""
        return self._due_ns if self.rate_hz else NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """One measurement, if it has power."""
        measured = self._next(t_ns)
        if measured is None:
            return
        sent_ns = t_ns + self._delay_ns(t_ns)
        for frame_id, data in self.encode(measured).items():
            self._channel.transmit(frame_id, self._spoilt(data, t_ns), sent_ns, extended=frame_id > 0x7FF)
