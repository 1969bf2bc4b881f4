"""One servo: registers with their side effects, errors, restart, backup.

`motor_command.py` computes the motor's command from the registers. The servo converts the measurements of the
bus's `Sensing` to its own counts, direction and turns.
"""

from collections.abc import Callable

from hil.config.servo_models import Register, ServoModel
from hil.config.servo_models.x_series_codes import (
    BAUD_CODES,
    BAUD_RATES,
    CURRENT,
    POSITION,
    PWM,
    VELOCITY,
    WATCHDOG_STEP_S,
)
from hil.fakes.body_interface import Plant
from hil.fakes.servos.dynamixel import protocol
from hil.fakes.servos.dynamixel.control_table import GOALS, ControlTable, WriteRefused
from hil.fakes.servos.dynamixel.motor_command import Axis
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions

_TORQUE_ON_BY_GOAL = 8
_POSITION_GAINS = ("position_p_gain", "position_i_gain", "position_d_gain")
_VELOCITY_GAINS = ("velocity_p_gain", "velocity_i_gain")
_BACKUP_FIRMWARE = 45
_NO_GOAL: tuple[int, bytes, str, int] = (-1, b"", "", 0)


def _heard_by_nobody() -> None:
    """Nobody asks for changes."""


class Servo:
    """State of one servo, without its bus.

    Args:
        joint: index in the plant and in `hil.core.signals.SERVOS`.
        plant: plant that contains the motor.
        options: settings of the servo.
        model: control table and motor.

    Attributes:
        joint: index in the plant and in `hil.core.signals.SERVOS`.
        table: the control table.
        axis: motor control.
        dead: True if it has no power.
        busy_until_ns: end of the boot time, before which it receives nothing.
        velocity: last measured velocity, counts in the joint's direction.
        on_change: called when it may listen or answer otherwise from now on.
        temperature_limit, least_voltage, most_voltage: limits in raw counts, beyond which it sets an error.
    """

    def __init__(self, joint: int, plant: Plant, options: ServoBusOptions, model: ServoModel) -> None:
        self.joint, self._options, self._model = joint, options, model
        self.table = ControlTable(model)
        drive = joint < 4
        for name, raw in {
            "model_number": options.model_of(joint),
            "firmware_version": options.firmware_by_joint.get(joint, options.firmware),
            "id": options.ids[joint],
            "baud_rate": BAUD_CODES[options.baud],
            "return_delay_time": options.return_delay,
            "operating_mode": VELOCITY if drive else options.steer_mode,
            **options.eeprom.get(joint, {}),
        }.items():
            self.table.put(name, raw)
        zero = options.drive_start_counts[joint] if drive else model.zero_counts
        if not drive:
            zero += round(options.horn_rad[joint - 4] / model.rad_per_count)
        self.axis = Axis(joint, plant, self.table, zero)
        self.dead = False
        self.busy_until_ns = 0
        self._pending: tuple[int, bytes] | None = None
        self._backup: dict[str, int] | None = None
        self.velocity = 0
        self.on_change: Callable[[], None] = _heard_by_nobody
        self.boot(0, 0)
        self.busy_until_ns = 0

    @property
    def torque(self) -> bool:
        """Whether torque is on."""
        return self.axis.torque

    @property
    def present(self) -> int:
        """Present Position in register counts."""
        return self.axis.position.present

    @property
    def tripped(self) -> bool:
        """Whether the bus watchdog has stopped the motor."""
        return self.axis.tripped

    def answers_to(self, servo_id: int) -> bool:
        """Return whether an instruction packet to this ID addresses the servo."""
        return servo_id in (self.id, protocol.BROADCAST) or (servo_id == self.secondary <= 252)

    def answers(self, level: int) -> bool:
        """Return whether it answers an instruction of this level: 0 ping, 1 read, 2 all others."""
        return self.table.get("status_return_level") >= level

    @property
    def reads_fast(self) -> bool:
        """Whether it takes part in fast reads."""
        return self.firmware >= self._model.fast_read_firmware and self.answers(level=1)

    def boot(self, t_ns: int, encoder: int) -> None:
        """Power up or reboot: reset RAM and errors, count within one turn, receive nothing until booted."""
        self.axis.position.encoder = encoder
        self.table.reset_ram()
        startup = self.table.get("startup_configuration")
        if self._backup is not None:
            self.table.put("backup_ready", 1)
            if startup & 2 and self.firmware >= _BACKUP_FIRMWARE:
                self.table.restore(self._backup, eeprom=False)
        self.booted_ns = self.busy_until_ns = t_ns
        self.busy_until_ns += round(self._options.boot_s * 1e9)
        self._pending, self._shut_down = None, False
        self._load()
        self.axis.start_over()
        if startup & 1 and self.firmware >= _BACKUP_FIRMWARE:
            self._set_torque(True)

    def reboot(self, t_ns: int) -> None:
        """Reboot at the present position."""
        self.boot(t_ns, self.axis.position.encoder)

    def lose_power(self) -> None:
        """Handle a loss of supply: torque off."""
        self.dead = True
        self.on_change()
        self.axis.lose_power()

    def slip(self, counts: int) -> None:
        """Shift the encoder by a slip of its magnet on the shaft."""
        self.axis.position.slip(counts)

    def sense(self, encoder: int, velocity: int) -> None:
        """Set the measured encoder counts (joint direction, from joint angle 0) and velocity."""
        self.axis.position.encoder, self.velocity = encoder, velocity

    def show(self, t_ns: int, velocity: int, current: int, duty: float, voltage: int, celsius: int) -> None:
        """Update the live registers (realtime tick to temperature); call `sense` before."""
        axis, present = self.axis, self.present
        sign, trajectory = axis.position.sign, axis.trajectory
        tick = (t_ns - self.booted_ns) // 1_000_000 % 32768
        moving = trajectory.ongoing or abs(velocity) > self._moving_threshold
        goal_velocity = round(trajectory.velocity)
        pwm = round(sign * duty * self._model.full_pwm)
        values = (
            tick,
            moving,
            axis.moving_status(present),
            pwm,
            sign * current,
            sign * velocity,
            present,
            goal_velocity,
            round(trajectory.position),
            voltage,
            celsius,
        )
        measured = self.table.layout.measured
        self.table.put_row(measured, measured.pack(*values))

    def motion(self, encoder: int, velocity: int, current: int) -> tuple[int, int, int]:
        """Set the measurements; return the registers read in every cycle: current, velocity and position.

        Args:
            encoder: counts from joint angle 0; all three are in the joint's direction.
            velocity: velocity counts.
            current: current counts.
        """
        self.sense(encoder, velocity)
        sign = self.axis.position.sign
        return sign * current, sign * velocity, self.present

    def repeats(self, address: int, data: bytes) -> bool:
        """Whether bytes are the latest goal again and the motor stands there: writing has no effect."""
        return (address, data) == self._latest[:2] and self.axis.stands_at(*self._latest[2:])

    def write(self, address: int, data: bytes, *, dry: bool = False) -> int:
        """Write registers with all side effects (`dry`: check only); returns the error number."""
        try:
            plan = self.table.plan(address, len(data))
            values = [(r, r.decode(data[k : k + r.size])) for r, k in plan]
            for register, raw in values:
                self._check(register, raw)
        except WriteRefused as refused:
            return refused.code
        if not dry:
            self._latest = _NO_GOAL
            for register, raw in values:
                self._store(register, raw)
            if len(values) == 1 and values[0][0].name in GOALS:
                self._latest = (address, data, values[0][0].name, values[0][1])
        return protocol.OK

    def register_write(self, address: int, data: bytes) -> int:
        """Store a write for a later `act`; returns the error number."""
        error = self.write(address, data, dry=True)
        if error == protocol.OK:
            self._pending = (address, data)
            self.table.put("registered_instruction", 1)
        return error

    def act(self) -> int:
        """Execute the stored write; returns the error number."""
        if self._pending is None:
            return protocol.INSTRUCTION_ERROR
        (address, data), self._pending = self._pending, None
        self.table.put("registered_instruction", 0)
        return self.write(address, data)

    def watchdog_ns(self) -> int:
        """Timeout of the bus watchdog, 0 while it is off."""
        return self._watchdog_ns if self.axis.torque and not self.axis.tripped else 0

    def trip(self) -> None:
        """Handle a timeout of the bus watchdog: stop, hold, and set the register Bus Watchdog to -1."""
        self.table.put("bus_watchdog", -1)
        self.axis.trip()

    def raise_error(self, bits: int) -> None:
        """Set bits of Hardware Error Status; switch torque off if the register Shutdown selects them."""
        self.table.put("hardware_error_status", self.table.get("hardware_error_status") | bits)
        self.alert = protocol.ALERT
        if bits & self.table.get("shutdown"):
            self._shut_down = True
            self._set_torque(False)

    def clear_turns(self) -> int:
        """Reduce the position to one turn (instruction 0x10); returns the error number."""
        if self.axis.trajectory.ongoing or abs(self.velocity) > self._moving_threshold:
            return protocol.RESULT_FAIL
        self.axis.forget_turns()
        self.axis.drive()
        return protocol.OK

    def back_up(self, parameters: bytes) -> int:
        """Store or check a backup (0x20); returns the error number. `restore` does the restoring."""
        if self.firmware < _BACKUP_FIRMWARE:
            return protocol.INSTRUCTION_ERROR
        if parameters not in (b"\x01CTRL", b"\x02CTRL"):
            return protocol.DATA_RANGE
        if self.torque or (parameters[0] == 2 and self._backup is None):
            return protocol.RESULT_FAIL
        if parameters[0] == 1:
            self._backup = self.table.snapshot()
            self.table.put("backup_ready", 1)
        return protocol.OK

    def restore(self, t_ns: int) -> None:
        """Complete a restore: write the registers back, reboot, and write those in RAM again."""
        backup = dict(self._backup or {})
        self.table.restore(backup, eeprom=True)
        self.boot(t_ns, self.axis.position.encoder)
        self.table.restore(backup, eeprom=False)
        self._load()

    def factory_reset(self, level: int, t_ns: int) -> None:
        """Factory reset (0x06): 0xFF everything, 1 keeps the ID, 2 keeps ID and baud rate."""
        kept = {"model_number": 0, "firmware_version": 0}
        kept |= {"id": 0} if level in (1, 2) else {}
        kept |= {"baud_rate": 0} if level == 2 else {}
        kept = {name: self.table.get(name) for name in kept}
        self.table = ControlTable(self._model)
        for name, raw in kept.items():
            self.table.put(name, raw)
        self._backup = None
        self.boot(t_ns, self.axis.position.encoder)

    def _check(self, register: Register, raw: int) -> None:
        self.table.check(register, raw, self.axis.torque)
        name = register.name
        if self.axis.tripped and (name in GOALS or (name == "bus_watchdog" and raw)):
            raise WriteRefused(protocol.DATA_RANGE)
        if name == "goal_position" and self.axis.mode == POSITION:
            low, high = self.table.get("min_position_limit"), self.table.get("max_position_limit")
            if not low <= raw <= high:
                raise WriteRefused(protocol.DATA_LIMIT)
        if name == "secondary_id" and 252 < raw < 255:
            raise WriteRefused(protocol.DATA_RANGE)
        if name == "drive_mode" and raw & 2:
            raise WriteRefused(protocol.DATA_RANGE)

    def _store(self, register: Register, raw: int) -> None:
        name = register.name
        self.table.put(name, raw)
        if name in GOALS:
            if (
                not self.axis.torque
                and self._drive_mode & _TORQUE_ON_BY_GOAL
                and self.firmware >= _BACKUP_FIRMWARE
            ):
                self._set_torque(True)
            self.axis.pursue(name, raw)
            return
        if name == "torque_enable":
            self._set_torque(bool(raw))
        elif name == "bus_watchdog":
            self.axis.tripped = False
            self._watchdog_ns = round(raw * WATCHDOG_STEP_S * 1e9)
        elif name == "status_return_level":
            self.on_change()
        elif name == "operating_mode":
            self._change_mode(raw)
        elif register.eeprom:
            self._load()
            if name == "drive_mode":
                self.axis.position.wrap()

    def _change_mode(self, mode: int) -> None:
        table = self.table
        for name in (*_POSITION_GAINS, *_VELOCITY_GAINS):
            used = name in _VELOCITY_GAINS or mode not in (CURRENT, PWM)
            table.put(name, self._model.table[name].default if used else 0)
        table.put("profile_velocity", 0)
        table.put("profile_acceleration", 0)
        table.put("goal_pwm", table.get("pwm_limit"))
        table.put("goal_current", table.get("current_limit"))
        self._load()
        if mode == POSITION:
            self.axis.position.wrap()

    def _load(self) -> None:
        """Cache registers that are used often."""
        table = self.table
        self._latest = _NO_GOAL
        self.on_change()
        self.firmware = table.get("firmware_version")
        self.id, self.secondary = table.get("id"), table.get("secondary_id")
        self.baud = BAUD_RATES[table.get("baud_rate")]
        self.delay_ns = 2000 * table.get("return_delay_time")
        self._drive_mode = table.get("drive_mode")
        self.axis.load(table)
        self._moving_threshold = table.get("moving_threshold")
        self.temperature_limit = table.get("temperature_limit")
        self.least_voltage, self.most_voltage = table.get("min_voltage_limit"), table.get("max_voltage_limit")
        self._watchdog_ns = round(max(0, table.get("bus_watchdog")) * WATCHDOG_STEP_S * 1e9)
        self.alert = protocol.ALERT if table.get("hardware_error_status") else 0

    def _set_torque(self, on: bool) -> None:
        if on and self._shut_down:
            on = False
        self.table.put("torque_enable", int(on))
        self.axis.set_torque(on)
