"""What the keeper says to a controller and hears from it, in the words of the controller."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from hil.drivers.adhesion import vesc
from hil.drivers.adhesion.keeper.core import SetPoint
from hil.drivers.adhesion.vesc import Packet
from hil.vocabulary.errors import ConfigError, did_you_mean


class Heard(NamedTuple):
    """What a frame said: how a controller runs, or what somebody asks of it.

    Attributes:
        controller_id: which controller.
        report: figures by name; empty in an order.
        order: a set-point that somebody has sent.
    """

    controller_id: int
    report: Mapping[str, float]
    order: SetPoint | None = None


class Dialect(Protocol):
    """The frames of one kind of controller."""

    @abstractmethod
    def order(self, controller_id: int, point: SetPoint) -> vesc.Frame:
        """The frame that sets a set-point."""

    @abstractmethod
    def hear(self, frame_id: int, data: bytes | bytearray) -> Heard | None:
        """What an extended frame says; None where it says nothing to the keeper."""


_PACKETS = {"duty": Packet.SET_DUTY, "current_a": Packet.SET_CURRENT, "erpm": Packet.SET_RPM}
_QUANTITIES = {packet: quantity for quantity, packet in _PACKETS.items()}


class Vesc(Dialect):
    """The classic protocol of a VESC."""

    def order(self, controller_id: int, point: SetPoint) -> vesc.Frame:
        """A `SET_*` frame."""
        return vesc.order_frame(vesc.Order(controller_id, _PACKETS[point.quantity], point.value))

    def hear(self, frame_id: int, data: bytes | bytearray) -> Heard | None:
        """Status 1, 4 and 5, and everybody's set-points."""
        said = vesc.decode(frame_id, data)
        if isinstance(said, vesc.Status):
            figures = {"duty": said.duty, "current_a": said.current_a, "erpm": said.erpm}
            return Heard(said.controller_id, figures)
        if isinstance(said, vesc.Status4):
            return Heard(said.controller_id, {"fet_c": said.fet_c, "input_a": said.input_a})
        if isinstance(said, vesc.Status5):
            return Heard(said.controller_id, {"input_v": said.input_v})
        if isinstance(said, vesc.Order) and said.packet in _QUANTITIES:
            return Heard(said.controller_id, {}, SetPoint(_QUANTITIES[said.packet], said.value))
        return None


_DIALECTS: Mapping[str, Callable[[], Dialect]] = {"vesc": Vesc}


def dialect(name: str) -> Dialect:
    """A dialect by its name; raises `ConfigError`."""
    made = _DIALECTS.get(name)
    if made is None:
        raise ConfigError(
            f"no fan speaks {name!r}", expected="one of " + ", ".join(_DIALECTS),
            remedy=did_you_mean(name, _DIALECTS),
        )  # fmt: skip
    return made()
