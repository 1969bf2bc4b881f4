"""A sensor that streams on a CAN bus, in one frame or in several for each sample."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.links.can_bus import CanLink, frame_key, remedy_of_silence, shown_key
from hil.streams.streaming_sensor import C, S, StreamingSensor

_LOOK_S = 0.02


class CanSensor(StreamingSensor[C, S]):
    """Base of the drivers of such sensors: define `parse` and `sample`; the table has `FRAME_IDS`.

    A sample is complete when the last of its frames has come; one that lacks a frame is dropped. Identifiers
    above 0x7FF have 29 bits; `hil.links.can_bus.frame_key` gives the number for a lower one of 29 bits.

    Attributes:
        malformed: samples since `open` whose frames `parse` has rejected.
    """

    expected = "the device"

    def __init__(self, config: C, clock: Clock) -> None:
        super().__init__(config, clock)
        self._link = CanLink(self.name, config, clock, lambda key: key in self._ids)
        self._frames: dict[int, bytes] = {}
        self.malformed = 0

    @property
    def place(self) -> str:
        """Interface and channel, for messages."""
        return self._link.port

    @abstractmethod
    def parse(self, frames: Mapping[int, bytes]) -> Any:
        """The measurement of one sample's frames, by identifier; None where it is damaged: no sample."""

    def frame_ids(self) -> tuple[int, ...]:
        """Identifiers of the frames of one sample, in the order in which they are sent."""
        ids: tuple[int, ...] = self.config.FRAME_IDS
        return ids

    def identify(self) -> Mapping[str, str]:
        """What is known of the device: by default its table's model."""
        return {"model": str(self.config.model)}

    def _connect(self) -> Mapping[str, str]:
        """Wait for a first sample."""
        self._ids, self._others = self.frame_ids(), set[int]()
        self._link.open()
        self.malformed = 0
        until_ns = self.clock.now_ns() + nanoseconds(self.config.open_timeout_s)
        while not self._take(self.clock.now_ns(), _LOOK_S):
            if self.clock.now_ns() >= until_ns:
                raise self._no_answer()
        return self.identify()

    def _no_answer(self) -> DeviceError:
        if not self._others:
            return self.silent(f"no {self.what} for {self.config.open_timeout_s:.1f} s")
        message = ", ".join(map(shown_key, sorted(self._others)[:8]))
        return DeviceError(
            self.name,
            f"no frame of {self.expected}; seen {message}",
            port=self.place,
            expected=", ".join(map(shown_key, self._ids)),
            remedy=self.remedy,
        )

    def _disconnect(self) -> None:
        self._link.close()
        self._frames.clear()

    def _take(self, now_ns: int, wait_s: float = 0.0) -> list[tuple[Any, int]]:
        found: list[tuple[Any, int]] = []
        for arrived_ns, message in self._link.take(wait_s):
            frame_id = frame_key(message.arbitration_id, message.is_extended_id)
            if frame_id not in self._ids:
                self._others.add(frame_id)
                continue
            if frame_id == self._ids[0]:
                self._frames.clear()
            self._frames[frame_id] = bytes(message.data)
            if len(self._frames) == len(self._ids):
                item = self.parse(dict(self._frames))
                self._frames.clear()
                if item is None:
                    self.malformed += 1
                else:
                    found.append((item, arrived_ns))
        if found:
            self._link.error = ""
        return found

    def silent(self, what: str) -> DeviceTimeoutError:
        """The error of a device that sends nothing."""
        node = self.expected.removeprefix("the ")
        return DeviceTimeoutError(
            self.name,
            what + self.silence_details(),
            port=self.place,
            expected=f"{self.config.rate_hz:g} per second",
            remedy=remedy_of_silence(self.name, self.config, node),
        )

    def silence_details(self) -> str:
        """Errors that the CAN interface has reported."""
        return self._link.bus_errors()
