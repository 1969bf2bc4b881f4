"""RAM of the servos: what is written at open, checked now and then, and restored after a restart.

A servo that has restarted (brown-out, reboot) is without torque, gains, goal map and watchdog, and does not
report that. A servo whose bus watchdog has tripped silently ignores goals. Both are found by the audit, a
small group read through indirect data, and repaired with the robot held where it is.
"""

import logging
from collections.abc import Mapping, Sequence

from hil.config.servo_models import shared_register
from hil.config.servo_models.x_series_codes import hardware_error_text
from hil.config.servos import ServosConfig
from hil.core.errors import DeviceError
from hil.core.signals import SERVOS, Status
from hil.drivers.servos.dynamixel import packets
from hil.drivers.servos.dynamixel.bus import Bus
from hil.drivers.servos.dynamixel.cyclic_read import Reading
from hil.drivers.servos.dynamixel.packets import GroupRead
from hil.drivers.servos.dynamixel.register_map import AUDIT_LENGTH, FULL_LEVEL, RegisterMap

_LOG = logging.getLogger(__name__)

ANSWERING = (Status.OK, Status.RESET, Status.HARDWARE_ERROR)
"""Statuses of a servo that answers."""
_ATTEMPTS = 3
_ATTEMPTS_ON = 12
"""A host that is busy starting programs may receive nothing for a quarter of a second."""


def acknowledge_all(bus: Bus, ids: Sequence[int]) -> None:
    """Set the Status Return Level at which servos, of any model, answer both reads and writes."""
    level = bytes((FULL_LEVEL,))
    bus.send(packets.sync_write(shared_register("status_return_level").address, 1, [(i, level) for i in ids]))


class RamRecovery:
    """Writes the required contents of RAM, checks and restores them.

    Args:
        bus: open bus.
        config: IDs, registers and watchdog of the bench.
        registers: register map of the servos' model.
        device: name in errors and logs.
        fast: True to use fast sync reads.

    Attributes:
        mapped: True if all servos have the goal map, so that goals go through indirect data.
        torque: True if torque should be on.
        released: True if it was on and has been switched off.
        hardware_error: (8,) Hardware Error Status as last read.
    """

    def __init__(
        self, bus: Bus, config: ServosConfig, registers: RegisterMap, device: str, *, fast: bool
    ) -> None:
        self._bus, self._config, self._device, self._fast = bus, config, device, fast
        self._ids, self._map = config.ids, registers
        drive, steer = registers.encoded(config.drive_registers), registers.encoded(config.steer_registers)
        self._registers = [drive] * 4 + [steer] * 4
        self.mapped = True
        self.torque = self.released = False
        self.hardware_error = [0] * len(SERVOS)

    def prepare(self, blocks: Sequence[bytes]) -> None:
        """Write RAM at open; a robot that is held by torque stays held.

        Raises:
            DeviceError: a servo refused or did not acknowledge.
        """
        torque = [self._map.from_block(b, "torque_enable") for b in blocks]
        self.hardware_error = [self._map.from_block(b, "hardware_error_status") for b in blocks]
        self.mapped = self._map_goals(torque)
        for joint, servo_id in enumerate(self._ids):
            self._bus.demand(servo_id, self._map.watchdog, b"\x00", "bus watchdog")
            if joint < 4:
                self._bus.demand(servo_id, self._map.goal_velocity, bytes(4), "zero goal velocity")
            for address, data in self._registers[joint]:
                self._bus.demand(servo_id, address, data, f"register at {address}")

    def _map_goals(self, torque: Sequence[int]) -> bool:
        """Set indirect addresses 1..21, which a servo with torque on does not allow."""
        for joint, servo_id in enumerate(self._ids):
            wanted = self._map.indirect_map(self._map.goal_addresses[joint])
            answer = self._bus.read(servo_id, self._map.indirect_address, len(wanted))
            if answer.data == wanted:
                continue
            if torque[joint]:
                _LOG.warning("%s: %s has torque on and no goal map: bulk writes", self._device, SERVOS[joint])
                return False
            self._bus.demand(servo_id, self._map.indirect_address, wanted, "indirect addresses")
        return True

    def switch_on(self, hold: bytes, ids: Sequence[int]) -> None:
        """Send hold goals, arm the watchdog, switch torque on, and check that it is on.

        Args:
            hold: packet of goals at which nothing moves.
            ids: servos that answer.

        Raises:
            DeviceError: torque has not come on at a servo.
        """
        count = bytes((self._config.watchdog_count,))
        self.torque = True
        for _ in range(_ATTEMPTS_ON):
            self._bus.send(hold)
            self._bus.send(packets.sync_write(self._map.watchdog, 1, [(i, count) for i in self._ids]))
            self._bus.send(packets.sync_write(self._map.torque, 1, [(i, b"\x01") for i in self._ids]))
            state = self.audit(ids)
            off = [SERVOS[j] for j, (torque, _) in state.items() if not torque]
            off += [f"{name} (no answer)" for j, name in enumerate(SERVOS) if j not in state]
            if not off:
                return
        raise DeviceError(
            self._device,
            "torque did not come on: " + ", ".join(off),
            port=self._config.port,
            expected="Torque Enable 1",
            remedy="look for hardware errors with `hil doctor`",
        )

    def switch_off(self, ids: Sequence[int]) -> None:
        """Switch off torque, then the watchdog, and check that torque is off.

        Raises:
            DeviceError: a servo still has its torque, or does not answer.
        """
        self.released |= self.torque
        self.torque = False
        for _ in range(_ATTEMPTS):
            self._bus.send(packets.sync_write(self._map.torque, 1, [(i, b"\x00") for i in self._ids]))
            self._bus.send(packets.sync_write(self._map.watchdog, 1, [(i, b"\x00") for i in self._ids]))
            state = self.audit(ids)
            left = [SERVOS[j] for j, (torque, _) in state.items() if torque]
            asked = [self._ids.index(i) for i in ids]
            left += [f"{SERVOS[j]} (no answer)" for j in asked if j not in state]
            if state and not left:
                return
        raise DeviceError(
            self._device,
            "torque is not off: " + (", ".join(left) if state else "no servo answers"),
            port=self._config.port,
            expected="Torque Enable 0",
            remedy="cut the servos' supply",
        )

    def audit(self, ids: Sequence[int]) -> dict[int, tuple[int, int]]:
        """(torque, watchdog) by joint, of those among `ids` that answer; stores hardware errors.

        Waits longer than a cycle may, when the host is busy.
        """
        if not ids:
            return {}
        where = self._map
        address, length = (
            (where.audit_data, AUDIT_LENGTH)
            if self.mapped
            else (where.direct_audit, where.direct_audit_length)
        )
        group = GroupRead(ids, address, length, fast=self._fast)
        delays = 1 if self._fast else len(ids)
        with self._bus.port.patient():
            timeout_s = self._bus.port.reply_s(len(group.request), group.expected, delays)
        answers = group.answers(self._bus.exchange(group, timeout_s).data)
        state = {}
        for servo_id, answer in answers.items():
            if answer.status is Status.OK:
                joint = self._ids.index(servo_id)
                torque, watchdog, self.hardware_error[joint] = where.audit_values(answer.data)
                state[joint] = (torque, watchdog)
        return state

    def judge(self, reading: Reading) -> dict[int, tuple[int, int]]:
        """(torque, watchdog) by joint from a full read; (0, 0) where the map is lost."""
        state = {}
        rows = reading.registers
        for joint, status in enumerate(reading.status):
            if status is Status.OK:
                self.hardware_error[joint] = rows["error"][joint]
                state[joint] = (rows["torque"][joint], rows["watchdog"][joint])
            elif status is Status.RESET:
                self.hardware_error[joint] = 0
                state[joint] = (0, 0)
        return state

    def repair(
        self, state: Mapping[int, tuple[int, int]], goals: Sequence[int], *, paused: bool = False
    ) -> tuple[int, ...]:
        """Repair what an audit found; returns the joints that had lost torque or were stopped.

        Args:
            state: (torque, watchdog) by joint, from `audit` or `judge`.
            goals: (8,) raw goals at which the robot is held.
            paused: True if there was no request for longer than the watchdog's time: it was expected to trip.
        """
        if not self.torque:
            return ()
        armed = self._config.watchdog_count
        repaired, tripped, restarted = [], [], []
        for joint, (torque, watchdog) in state.items():
            if torque and watchdog == armed:
                continue
            if self.hardware_error[joint]:
                continue
            if torque:
                tripped.append(SERVOS[joint])
            else:
                restarted.append(SERVOS[joint])
                self.restore(joint)
            self._resume(joint, goals[joint])
            repaired.append(joint)
        if tripped:
            level = logging.DEBUG if paused else logging.WARNING
            _LOG.log(level, "%s: bus watchdogs tripped, armed again: %s", self._device, ", ".join(tripped))
        if restarted:
            _LOG.warning("%s: restarted, set up again: %s", self._device, ", ".join(restarted))
        return tuple(repaired)

    def resend_torque(self, status: Sequence[Status]) -> None:
        """Send torque on to silent servos: one that has restarted may receive it, but its answers are lost.

        It then holds with its power-up goals, at which it stands still, until it can be set up again.
        """
        unheard = [i for i, s in zip(self._ids, status, strict=True) if s not in ANSWERING]
        if self.torque and unheard:
            self._bus.send(packets.sync_write(self._map.torque, 1, [(i, b"\x01") for i in unheard]))

    def trouble(self, reading: Reading) -> dict[str, str]:
        """What keeps a servo from holding, by name, from a full read that `judge` has evaluated."""
        armed, rows, found = self._config.watchdog_count, reading.registers, {}
        for joint, status in enumerate(reading.status):
            reason = ""
            if status is Status.RESET:
                reason = "restarted, torque is off"
            elif status is not Status.OK:
                reason = status.value
            elif self.hardware_error[joint]:
                reason = f"hardware error: {hardware_error_text(self.hardware_error[joint])}"
            elif not rows["torque"][joint]:
                reason = "torque is off"
            elif rows["watchdog"][joint] != armed:
                reason = "its bus watchdog has tripped"
            if reason:
                found[SERVOS[joint]] = f"ID {self._ids[joint]}: {reason}"
        return found

    def restore(self, joint: int) -> None:
        """Write map and registers again into a servo that has restarted; torque and watchdog stay off.

        Torque is switched off first: a servo that got it with the others would refuse the map for ever.
        """
        servo_id = self._ids[joint]
        if self.mapped:
            self._bus.send(packets.sync_write(self._map.torque, 1, [(servo_id, b"\x00")]))
            wanted = self._map.indirect_map(self._map.goal_addresses[joint])
            self._bus.send(packets.sync_write(self._map.indirect_address, len(wanted), [(servo_id, wanted)]))
        for address, data in self._registers[joint]:
            self._bus.send(packets.sync_write(address, len(data), [(servo_id, data)]))

    def _resume(self, joint: int, goal: int) -> None:
        """Clear the watchdog, set the goal, arm the watchdog, switch torque on."""
        servo_id = self._ids[joint]
        data = (goal & 0xFFFFFFFF).to_bytes(4, "little")
        for address, value in (
            (self._map.watchdog, b"\x00"),
            (self._map.goal_addresses[joint], data),
            (self._map.watchdog, bytes((self._config.watchdog_count,))),
            (self._map.torque, b"\x01"),
        ):
            self._bus.send(packets.sync_write(address, len(value), [(servo_id, value)]))

    def read_hardware_error(self, joint: int) -> int:
        """Hardware Error Status of one servo; the last known one if it does not answer."""
        answer = self._bus.read(self._ids[joint], self._map.hardware_error, 1, attempts=1)
        if answer.status is Status.OK:
            self.hardware_error[joint] = answer.data[0]
        return self.hardware_error[joint]

    def refuse_hardware_errors(self) -> None:
        """Raise `DeviceError` that lists servos with a hardware error."""
        found = {SERVOS[j]: hardware_error_text(e) for j, e in enumerate(self.hardware_error) if e}
        if found:
            raise DeviceError(
                self._device,
                "hardware errors: " + ", ".join(f"{k} ({v})" for k, v in found.items()),
                port=self._config.port,
                expected="none",
                remedy="remove the cause, then reboot the servo (power off and on)",
            )
