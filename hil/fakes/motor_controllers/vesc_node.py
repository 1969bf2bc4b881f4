"""The fan's motor controller on CAN: a VESC with set-points, status messages, limits and command timeout.

Any `SET_*` frame restarts the timeout; a ping does not. A new VESC sends no status messages until they are
switched on. Values out of range are clipped, never rejected.
"""

from collections.abc import Iterator
from typing import ClassVar

import can

from hil.config.adhesion import VescConfig
from hil.fakes.can_channel import CanChannel, CanFrame
from hil.fakes.motor_controllers import vesc_messages as vesc_frames
from hil.fakes.motor_controllers.fan_physics import HIGHEST_DUTY, Demand
from hil.fakes.motor_controllers.forces_on_robot import Load
from hil.fakes.motor_controllers.motor_controller import MotorNode
from hil.fakes.motor_controllers.true_parameters import AdhesionTruthOptions, MotorTruthOptions
from hil.fakes.world import World

_COUNTS_PER_TURN = 6
_WRONG, _DELAY_S = 1.3, 0.1
_SPEED_NOISE_RPM, _AMPS_NOISE_A = 15.0, 0.3


class VescNode(MotorNode):
    """Emulated VESC; takes the arguments of `MotorNode`."""

    Options: ClassVar[type[MotorTruthOptions]] = AdhesionTruthOptions

    def __init__(
        self,
        world: World,
        channel: CanChannel,
        config: VescConfig,
        options: MotorTruthOptions,
        name: str = "adhesion",
        *,
        load: Load | None = None,
        motor: int = 0,
    ) -> None:
        super().__init__(world, channel, config, options, name, load=load, motor=motor)
        self._vesc = options.true_ratings(config)
        self._frozen: dict[int, bytes] = {}

    def _take(self, message: CanFrame | can.Message, t_ns: int) -> None:
        """Handle a frame received from the bus."""
        command, receiver = message.arbitration_id >> 8, message.arbitration_id & 0xFF
        if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        if self._asleep(t_ns) or receiver not in (self._vesc.controller_id, vesc_frames.ALL_SERVOS):
            return
        data = bytes(message.data)
        if command in vesc_frames.SET_COMMANDS:
            self._obey(command, vesc_frames.command_value(command, data), t_ns)
        elif command == vesc_frames.PING and data:
            self._send(vesc_frames.PONG << 8 | data[0], bytes((self._vesc.controller_id, 0)), t_ns)
        elif command == vesc_frames.SHORT_BUFFER and len(data) >= 3:
            self._answer(data[0], data[2], t_ns)

    def _obey(self, command: int, value: float | None, t_ns: int) -> None:
        """Apply a `SET_*` command; values out of range are clipped."""
        if value is None:
            return
        self._commanded_ns = t_ns
        limit_a = self._options.highest_a
        if command == vesc_frames.SET_DUTY:
            self.fan.demand = Demand("duty", min(max(value, -HIGHEST_DUTY), HIGHEST_DUTY))
        elif command == vesc_frames.SET_RPM:
            self.fan.demand = Demand("rpm", value / self._vesc.pole_pairs)
        elif command in (vesc_frames.SET_CURRENT, vesc_frames.SET_CURRENT_REL):
            amps = value * (limit_a if command == vesc_frames.SET_CURRENT_REL else 1.0)
            self.fan.demand = Demand("current", min(max(amps, -limit_a), limit_a)) if amps else Demand()
        else:
            self.fan.demand = Demand("brake")

    def _answer(self, asker_id: int, question: int, t_ns: int) -> None:
        """Answer a query for firmware version or settings."""
        o = self._options
        if question == vesc_frames.FW_VERSION:
            payload = vesc_frames.firmware_reply(o.firmware)
        elif question == vesc_frames.GET_APPCONF:
            masks = tuple(sum(1 << (m - 1) for m in which) for which in (o.messages_1, o.messages_2))
            payload = vesc_frames.settings_reply(
                self._vesc.controller_id, o.timeout_s, (o.rate_1_hz, o.rate_2_hz), (masks[0], masks[1])
            )
        else:
            return
        for frame_id, data in vesc_frames.in_pieces(self._vesc.controller_id, asker_id, payload):
            self._send(frame_id, data, t_ns)

    def _report(self, rate: int, t_ns: int) -> None:
        """Send the status messages of one of the two rates and schedule the next ones."""
        self._next_report(rate, t_ns)
        if self._asleep(t_ns):
            return
        delayed = self._faults.find("delayed", t_ns)
        send_ns = t_ns + (delayed.delay_ns(_DELAY_S) if delayed is not None else 0)
        which = self._options.messages_2 if rate else self._options.messages_1
        for command, data in self._messages(which):
            if not self._faults.none:
                data = self._spoilt(command, data, t_ns)
            self._send(command << 8 | self._vesc.controller_id, data, send_ns)

    def _messages(self, which: tuple[int, ...]) -> Iterator[tuple[int, bytes]]:
        """Yield command and data of the status messages with these numbers."""
        fan = self.fan
        for number in which:
            if number == 1:
                noise: list[float] = self._rng.standard_normal(2).tolist()
                rpm = fan.speed_rpm + self._offset_rpm + (_SPEED_NOISE_RPM * noise[0] if fan.speed_rpm else 0)
                amps = fan.motor_a + (_AMPS_NOISE_A * noise[1] if fan.motor_a else 0.0)
                yield 9, vesc_frames.status_1(self._vesc.pole_pairs * rpm, amps, fan.duty)
            elif number in (2, 3):
                yield 12 + number, vesc_frames.status_2_or_3(fan.used_ah if number == 2 else fan.used_wh)
            elif number == 4:
                yield 16, vesc_frames.status_4(fan.fet_c, self._options.ambient_c, fan.input_a)
            elif number == 5:
                yield (
                    27,
                    vesc_frames.status_5(_COUNTS_PER_TURN * self._vesc.pole_pairs * self._turns, fan.input_v),
                )
            elif number == 6:
                yield 58, vesc_frames.status_6()

    def _spoilt(self, command: int, data: bytes, t_ns: int) -> bytes:
        """Apply the active faults to the data of a status message."""
        find = self._faults.find
        wrong = find("wrong", t_ns)
        if wrong is not None and command == 9:
            erpm = int.from_bytes(data[:4], "big", signed=True) * wrong.option("factor", _WRONG)
            data = vesc_frames.clipped(erpm, 32).to_bytes(4, "big", signed=True) + data[4:]
        if find("stuck", t_ns) is not None:
            data = self._frozen.setdefault(command, data)
        else:
            self._frozen.clear()
        return data
