"""The emulated DroneCAN motor controller, on PyPI `dronecan`: commands, status, node information."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import can

from hil.config.dronecan import DroneCanConfig
from hil.core.clock import NS_PER_S
from hil.fakes.can_channel import CanChannel, CanFrame
from hil.fakes.motor_controllers.fan_physics import HIGHEST_DUTY, Demand
from hil.fakes.motor_controllers.motor_controller import MotorNode
from hil.fakes.motor_controllers.true_parameters import FanTruthOptions, MotorTruthOptions, StatusMessage
from hil.fakes.world import World
from hil.links.dronecan.library import Receiver, frames_of, library

_FULL_RAW = 8191
_HIGHEST_RPM = (1 << 17) - 1
_KELVIN = 273.15
_WRONG, _DELAY_S = 1.3, 0.1
_NOISE_RPM, _NOISE_A = 15.0, 0.3
_LOW_PRIORITY = 31
_NAME = "org.vesc.emulated"


@dataclass(frozen=True)
class DroneCanTruthOptions(FanTruthOptions):
    """Imperfections as for a VESC; `rate_1_hz` is that of `esc.Status`, `rate_2_hz` that of `NodeStatus`."""

    rate_1_hz: float = 50.0
    rate_2_hz: float = 1.0
    messages_1: tuple[StatusMessage, ...] = (1,)
    messages_2: tuple[StatusMessage, ...] = (1,)


class DroneCanNode(MotorNode):
    """One controller; arguments as for `MotorNode`."""

    Options = DroneCanTruthOptions

    def __init__(
        self,
        world: World,
        channel: CanChannel,
        config: DroneCanConfig,
        options: MotorTruthOptions,
        name: str = "adhesion",
    ) -> None:
        self._node_id, self._index = config.node_id, config.esc_index
        self._sent: Counter[str] = Counter()
        self._frozen: tuple[float, ...] | None = None
        super().__init__(world, channel, config, options, name)
        library()  # import now: it takes a second of real time, and raises here where the package is missing

    @cached_property
    def _messages(self) -> Any:
        return library().uavcan

    @cached_property
    def _receiver(self) -> Receiver:
        return Receiver()

    def _take(self, message: CanFrame | can.Message, t_ns: int) -> None:
        """Process a frame from the bus."""
        if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        transfer = self._receiver.take(message.arbitration_id, bytes(message.data))
        if transfer is None or self._asleep(t_ns):
            return
        name = _name_of(transfer.payload)
        if transfer.service_not_message:
            if name == "uavcan.protocol.GetNodeInfo" and transfer.dest_node_id == self._node_id:
                self._introduce(transfer, t_ns)
        elif name == "uavcan.equipment.esc.RawCommand":
            self._obey(transfer.payload.cmd, t_ns, self._raw)
        elif name == "uavcan.equipment.esc.RPMCommand":
            self._obey(transfer.payload.rpm, t_ns, lambda rpm: Demand("rpm", float(rpm)))

    def _obey(self, values: Any, t_ns: int, demand: Callable[[int], Demand]) -> None:
        """Apply the set-point for this controller, if there is one; no value is refused."""
        if self._index < len(values):
            value = int(values[self._index])
            self.fan.demand = demand(value) if value else Demand()
            self._commanded_ns = t_ns

    @staticmethod
    def _raw(value: int) -> Demand:
        return Demand("duty", min(max(value / _FULL_RAW, -HIGHEST_DUTY), HIGHEST_DUTY))

    def _introduce(self, asked: Any, t_ns: int) -> None:
        """Answer a request for node information."""
        if not asked.source_node_id:
            return
        answer = self._messages.protocol.GetNodeInfo.Response()
        answer.name, answer.status = _NAME, self._node_status(t_ns)
        major, _, minor = self._options.firmware.partition(".")
        answer.software_version.major, answer.software_version.minor = int(major), int(minor)
        answer.hardware_version.unique_id = [self._node_id] * 16
        self._put(
            frames_of(
                answer,
                source=self._node_id,
                transfer_id=asked.transfer_id,
                priority=asked.transfer_priority,
                dest_node_id=asked.source_node_id,
                service_not_message=True,
                request_not_response=False,
            ),
            t_ns,
        )

    def _node_status(self, t_ns: int) -> Any:
        status = self._messages.protocol.NodeStatus()
        status.uptime_sec = (t_ns - self._booted_ns) // NS_PER_S
        return status

    def _report(self, rate: int, t_ns: int) -> None:
        """`esc.Status` at the first rate, `NodeStatus` at the second."""
        self._next_report(rate, t_ns)
        if self._asleep(t_ns):
            return
        payload = self._node_status(t_ns) if rate else self._status(t_ns)
        transfer_id = self._sent[_name_of(payload)] % 32
        self._sent[_name_of(payload)] += 1
        delayed = self._faults.find("delayed", t_ns)
        send_ns = t_ns + (delayed.delay_ns(_DELAY_S) if delayed is not None else 0)
        frames = frames_of(payload, source=self._node_id, transfer_id=transfer_id, priority=_LOW_PRIORITY)
        self._put(frames, send_ns)

    def _status(self, t_ns: int) -> Any:
        """`esc.Status` of the motor, with the active faults applied."""
        fan, noise = self.fan, self._rng.standard_normal(2)
        rpm = fan.speed_rpm + self._offset_rpm + (_NOISE_RPM * noise[0] if fan.speed_rpm else 0.0)
        amps = fan.input_a + (_NOISE_A * noise[1] if fan.input_a else 0.0)
        if (wrong := self._faults.find("wrong", t_ns)) is not None:
            rpm *= wrong.option("factor", _WRONG)
        share = abs(fan.motor_a) / self._options.highest_a
        figures: tuple[float, ...] = (rpm, amps, fan.input_v, fan.fet_c, share)
        if self._faults.find("stuck", t_ns) is None:
            self._frozen = None
        else:
            self._frozen = figures = self._frozen or figures
        status = self._messages.equipment.esc.Status()
        status.rpm = round(min(max(figures[0], -_HIGHEST_RPM), _HIGHEST_RPM))
        status.current, status.voltage, status.temperature = figures[1], figures[2], figures[3] + _KELVIN
        status.power_rating_pct = min(127, math.floor(100.0 * figures[4]))
        status.esc_index = self._index
        return status

    def _put(self, frames: list[tuple[int, bytes]], t_ns: int) -> None:
        for frame_id, data in frames:
            self._send(frame_id, data, t_ns)


def _name_of(payload: Any) -> str:
    """Full name of a message's type."""
    import dronecan

    return str(dronecan.get_dronecan_data_type(payload))
