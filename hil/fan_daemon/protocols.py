"""Encodes set-points for a motor controller and decodes its reports: VESC and DroneCAN frames."""

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from itertools import count
from typing import NamedTuple, Protocol

from hil.core.clock import NS_PER_S
from hil.core.errors import ConfigError, did_you_mean
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.spec import Spec
from hil.links import vesc
from hil.links.dronecan import messages as dronecan
from hil.links.vesc import ALL_SERVOS, Packet

Wire = tuple[int, bytes]
"""Identifier and data of an extended frame."""


class DecodedFrame(NamedTuple):
    """The content of a frame: how a controller runs, or a set-point that some program sent to it.

    Attributes:
        controller_id: id of the controller.
        report: figures by name; `erpm` is in every report of its speed. Empty in an order.
        running: the set-point that would keep it as it runs; None at rest, and where that is unknown.
        order: a set-point that another program has sent to our fan.
    """

    controller_id: int
    report: Mapping[str, float] = {}
    running: SetPoint | None = None
    order: SetPoint | None = None


class MotorProtocol(Protocol):
    """The frames of one kind of controller, for one fan."""

    @abstractmethod
    def encode(self, point: SetPoint, t_ns: int) -> tuple[Wire, ...]:
        """The frames that set a set-point, sent at `t_ns`."""

    @abstractmethod
    def decode(self, frame_id: int, data: bytes | bytearray) -> DecodedFrame | None:
        """The content of an extended frame; None for one that the daemon has no use for."""


_PACKETS = {"duty": Packet.SET_DUTY, "current_a": Packet.SET_CURRENT, "erpm": Packet.SET_RPM}
_QUANTITIES = {packet: quantity for quantity, packet in _PACKETS.items()}
_RUNNING_DUTY = 0.02


class Vesc(MotorProtocol):
    """The classic protocol of a VESC."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec

    def encode(self, point: SetPoint, t_ns: int) -> tuple[Wire, ...]:
        """A `SET_*` frame for each controller."""
        packet, ids = _PACKETS[point.quantity], (self._spec.controller_id, *self._spec.also)
        return tuple(vesc.order_frame(vesc.Order(one, packet, point.value)) for one in ids)

    def decode(self, frame_id: int, data: bytes | bytearray) -> DecodedFrame | None:
        """Status 1, 4 and 5, and the set-points of all programs."""
        if frame_id & 0xFF in self._spec.also:
            return None
        message = vesc.decode(frame_id, data)
        if isinstance(message, vesc.Status):
            figures = {"duty": message.duty, "current_a": message.current_a, "erpm": message.erpm}
            running = SetPoint("duty", message.duty) if message.duty >= _RUNNING_DUTY else None
            return DecodedFrame(message.controller_id, figures, running)
        if isinstance(message, vesc.Status4):
            return DecodedFrame(message.controller_id, {"fet_c": message.fet_c, "input_a": message.input_a})
        if isinstance(message, vesc.Status5):
            return DecodedFrame(message.controller_id, {"input_v": message.input_v})
        if isinstance(message, vesc.Order) and message.packet in _QUANTITIES:
            if message.controller_id not in (self._spec.controller_id, ALL_SERVOS):
                return None
            point = SetPoint(_QUANTITIES[message.packet], message.value)
            return DecodedFrame(self._spec.controller_id, order=point)
        return None


_KELVIN = 273.15
_RUNNING_RPM = 500
_NODE_STATUS_NS = NS_PER_S


class DroneCan(MotorProtocol):
    """DroneCAN, by `details` of the spec.

    `esc_index` is the controller's place in the commands, `node_id` ours, `rpm_per_v` of the motor. Such a
    controller does not report its duty: the fan is taken over at its speed, and its duty is that of an
    unloaded motor at that speed. `erpm` is the speed as `esc.Status` counts it.
    """

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        wanted = {"esc_index", "node_id", "rpm_per_v"}
        if missing := wanted - set(spec.details):
            raise ConfigError(
                f"{spec.name}: details without {', '.join(sorted(missing))}",
                remedy="start its daemon by `hil adhesion keep`, from a bench file",
            )
        self._index, self._node_id = int(spec.details["esc_index"]), int(spec.details["node_id"])
        self._reader = dronecan.StatusReader()
        self._raw_ids, self._rpm_ids, self._status_ids = count(), count(), count()
        self._began_ns: int | None = None
        self._status_due_ns = 0

    def encode(self, point: SetPoint, t_ns: int) -> tuple[Wire, ...]:
        """A command frame, and once a second a NodeStatus of this node."""
        kind, ids = dronecan.RAW_COMMAND, self._raw_ids
        value = round(dronecan.FULL_RAW * point.value) if point.quantity == "duty" else 0
        if point.quantity == "erpm":
            kind, ids, value = dronecan.RPM_COMMAND, self._rpm_ids, round(point.value)
        command = dronecan.command_frame(
            kind, self._index, value, node_id=self._node_id, transfer_id=next(ids)
        )
        if self._began_ns is None:
            self._began_ns = self._status_due_ns = t_ns
        if t_ns < self._status_due_ns:
            return (command,)
        self._status_due_ns = t_ns + _NODE_STATUS_NS
        uptime_s = (t_ns - self._began_ns) // NS_PER_S
        here = dronecan.node_status_frame(uptime_s, node_id=self._node_id, transfer_id=next(self._status_ids))
        return command, here

    def decode(self, frame_id: int, data: bytes | bytearray) -> DecodedFrame | None:
        """The fan's status, and the set-points of all programs."""
        status = self._reader.take(frame_id, data)
        if status is not None and status.index == self._index:
            return self._status(status)
        found = dronecan.command_of(frame_id, data, self._index)
        if found is None:
            return None
        kind, value = found
        raw = kind == dronecan.RAW_COMMAND
        point = SetPoint("duty", value / dronecan.FULL_RAW) if raw else SetPoint("erpm", float(value))
        return DecodedFrame(self._spec.controller_id, order=point)

    def _status(self, status: dronecan.EscStatus) -> DecodedFrame:
        figures = {"erpm": float(status.rpm)}
        known = {
            "current_a": status.current_a,
            "input_v": status.voltage_v,
            "fet_c": status.temperature_k - _KELVIN,
        }
        figures.update((name, value) for name, value in known.items() if math.isfinite(value))
        free_rpm = self._spec.details["rpm_per_v"] * figures.get("input_v", 0.0)
        if free_rpm > abs(status.rpm):
            figures["duty"] = abs(status.rpm) / free_rpm
        running = SetPoint("erpm", float(status.rpm)) if status.rpm >= _RUNNING_RPM else None
        return DecodedFrame(status.node_id, figures, running)


_PROTOCOLS: Mapping[str, Callable[[Spec], MotorProtocol]] = {"vesc": Vesc, "dronecan": DroneCan}


def protocol_of(spec: Spec) -> MotorProtocol:
    """The protocol that a spec names, for its fan; raises `ConfigError`."""
    made = _PROTOCOLS.get(spec.protocol)
    if made is None:
        raise ConfigError(
            f"no fan speaks {spec.protocol!r}",
            expected="one of " + ", ".join(_PROTOCOLS),
            remedy=did_you_mean(spec.protocol, _PROTOCOLS),
        )
    return made(spec)
