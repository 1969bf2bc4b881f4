"""A sensor that sends unasked on a CAN bus, in one frame or in several for each sample."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from hil.drivers.can_link import CanLink
from hil.drivers.links.streaming import C, S, StreamingSensor
from hil.vocabulary.clock import Clock, nanoseconds

_LOOK_S = 0.01


class CanSensor(StreamingSensor[C, S]):
    """Base of such drivers: give `parse` and `sample`; the table gives `FRAME_IDS`.

    A sample is complete when the last of its frames has come; one that lacks a frame is dropped.

    Attributes:
        malformed: frames since `open` from which `parse` could make nothing.
    """

    expected = "the device on the CAN bus"

    def __init__(self, config: C, clock: Clock) -> None:
        super().__init__(config, clock)
        self._link = CanLink(self.name, config, clock)
        self._frames: dict[int, bytes] = {}
        self.malformed = 0

    @property
    def place(self) -> str:
        """Interface and channel."""
        return self._link.port

    @abstractmethod
    def parse(self, frames: Mapping[int, bytes]) -> Any:
        """The measurement of one sample's frames, by identifier; None where it is damaged."""

    def identify(self) -> Mapping[str, str]:
        """What is known of the device: by default its table's model."""
        return {"model": str(self.config.model)}

    def _connect(self) -> Mapping[str, str]:
        """Wait for a first sample."""
        self._link.open()
        self.malformed = 0
        until_ns = self.clock.now_ns() + nanoseconds(self.config.open_timeout_s)
        while not self._take(self.clock.now_ns()):
            if self.clock.now_ns() >= until_ns:
                raise self.silent(f"no {self.what} for {self.config.open_timeout_s:g} s")
            self.clock.sleep_until_ns(self.clock.now_ns() + nanoseconds(_LOOK_S))
        return self.identify()

    def _disconnect(self) -> bool:
        was_open = self._link.is_open
        self._link.close()
        self._frames.clear()
        return was_open

    def _take(self, now_ns: int) -> list[tuple[Any, int]]:
        found: list[tuple[Any, int]] = []
        ids = self.config.FRAME_IDS
        for arrived_ns, message in self._link.take():
            if message.arbitration_id not in ids:
                continue
            if message.arbitration_id == ids[0]:
                self._frames.clear()
            self._frames[message.arbitration_id] = bytes(message.data)
            if len(self._frames) == len(ids):
                item = self.parse(dict(self._frames))
                self._frames.clear()
                self.malformed += item is None
                found.append((item, arrived_ns))
        self.port_gone = not self._link.is_open
        return found

    def silence_details(self) -> str:
        """What the interface has reported."""
        return self._link.told()
