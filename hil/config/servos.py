"""Configuration of the eight servos on their bus (`[servos]` of the bench file)."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from hil.config.assumed_parameters import Parameter, order
from hil.config.device import DeviceConfig
from hil.config.field_types import Patience, Switch, WheelRate, Within
from hil.config.servo_models import ServoModel, model_text, models_text, servo_models
from hil.config.servo_models.x_series_codes import (
    BAUD_CODES,
    CURRENT_POSITION,
    EXTENDED,
    POSITION,
    WATCHDOG_STEP_S,
)

Id = Annotated[int, Within(0, 252, "IDs of a DYNAMIXEL bus")]
Ids = tuple[Id, Id, Id, Id]
Register = Annotated[int, Within(-(2**31), 2**31 - 1, "counts of a register of up to four bytes")]

_AHEAD_FROM_HZ = 100.0

Turnaround = Annotated[float, Within(0.0, 0.1, "s; a cycle has 0.01 s")]

STEER_MODES = {"position": POSITION, "extended": EXTENDED, "current_position": CURRENT_POSITION}
_OWNED = ("torque_enable", "status_return_level", "bus_watchdog", "goal_velocity", "goal_position")


class ServosConfig(DeviceConfig):
    """Address, checks, settings and limits of the servo bus.

    Attributes:
        port: any pyserial URL or device path.
        baud: baud rate of the bus; one that the servo's Baud Rate register has a code for.
        drive_ids, steer_ids: IDs in wheel order FL, BL, BR, FR.
        steer_mode: operating mode that the steering servos must have; drives must be in velocity mode.
        fast_sync_read: `auto` uses the fast reads when every firmware has them (45 on).
        prefetch: true to ask for the next state right after every command, so that a read need not wait for
            the bus; the sample is then most of a cycle old, and stamped so. Where it is left out: yes in real
            time from 100 Hz on, no in slower loops and in virtual time.
        usb_latency_s: latency timer of the USB adapter.
        return_delay_s: Return Delay Time that the servos are expected to have; larger is reported.
        reply_slack_s: silence beyond the computed time of a reply before it counts as lost.
        retry_budget_s: extra time that one `read` may take for lost replies and their repetition.
        dead_poll_s: interval at which a servo that no longer answers is polled.
        fail_after_s: uninterrupted failure of a servo that raises instead of being reported as data.
        watchdog_s: bus watchdog, a multiple of 20 ms up to 2.54 s: without a request for so long, the
            servos stop by themselves. On a wall at most 0.1 s; 0 leaves it off, on the floor only.
        health_period_s: interval at which voltage and temperature are read; torque and watchdog four times as
            often.
        model_number: model number of all eight servos: 1010 (XH430-W210), 1000 (XH430-W350), 1050
            (XH430-V210), 1040 (XH430-V350), 1030 (XM430-W210) or 1020 (XM430-W350). Where it is left out, the
            number that they tell decides, and all eight must agree; emulated ones are then XH430-W210.
        min_firmware: oldest firmware that the servos may have.
        velocity_limit_rad_s: wheel rate goals are clipped to it.
        steer_limit_rad: largest steering goal to either side of the servo's centre (2048 counts), rad; goals
            beyond are clipped and reported. Less the axis' `alignment.steer_zero_rad` the wheel has the range
            that `safety.steering_limit_rad` needs.
        drive_registers, steer_registers: RAM registers (gains, profiles, goal current and PWM) by name
            in the control table, raw counts, written at open and after a servo's restart.
    """

    model: Literal["dynamixel"] = "dynamixel"
    port: str = Field("/dev/ttyUSB0", min_length=1)
    baud: Annotated[int, Within(9600, 4_500_000, "codes of the Baud Rate register")] = 1_000_000
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("drive_ids", (order(3, 2, 1, 0), order(1, 0, 2, 3)), ("mocap", "tracker", "imu")),
        Parameter("steer_ids", (order(3, 2, 1, 0), order(0, 2, 1, 3)), ("encoders",)),
    )

    drive_ids: Ids = (1, 2, 3, 4)
    steer_ids: Ids = (5, 6, 7, 8)
    steer_mode: Literal["position", "extended", "current_position"] = "position"
    fast_sync_read: Literal["auto"] | Switch = "auto"
    prefetch: Switch | None = None
    usb_latency_s: Turnaround = 0.001
    return_delay_s: Annotated[float, Within(0.0, 508e-6, "s; 254 steps of 2 us")] = 0.0
    reply_slack_s: Annotated[float, Within(1e-5, 0.1, "s; a reply takes less than 1 ms")] = 0.0015
    retry_budget_s: Turnaround = 0.003
    dead_poll_s: Annotated[float, Within(0.001, 10.0, "a servo that is back must be seen soon")] = 0.25
    fail_after_s: Patience = 2.0
    watchdog_s: Annotated[float, Within(0.0, 2.54, "s; 127 steps of 20 ms")] = 0.08
    health_period_s: Patience = 1.0
    model_number: Annotated[int, Within(1, 65_535, "a register of two bytes")] | None = None
    min_firmware: Annotated[int, Within(0, 255, "a register of one byte")] = 38
    velocity_limit_rad_s: WheelRate = 4.9
    steer_limit_rad: Annotated[float, Within(0.01, 12.5664, "two turns wind up any cable")] = 2.618
    drive_registers: dict[str, Register] = Field(default_factory=dict)
    steer_registers: dict[str, Register] = Field(default_factory=dict)

    @property
    def ids(self) -> tuple[int, ...]:
        """All eight IDs in the order of `hil.core.signals.SERVOS`."""
        return self.drive_ids + self.steer_ids

    def asks_ahead(self, *, realtime: bool, rate_hz: float) -> bool:
        """`prefetch`, or what follows from how the loop runs where it was left out."""
        if self.prefetch is not None:
            return self.prefetch
        return realtime and rate_hz >= _AHEAD_FROM_HZ

    @property
    def watchdog_count(self) -> int:
        """Value of the Bus Watchdog register."""
        return round(self.watchdog_s / WATCHDOG_STEP_S)

    @field_validator("baud")
    @classmethod
    def _known_baud(cls, value: int) -> int:
        if value not in BAUD_CODES:
            raise ValueError("baud must be one of " + ", ".join(str(b) for b in BAUD_CODES))
        return value

    @field_validator("model_number")
    @classmethod
    def _known_model(cls, value: int | None) -> int | None:
        if value is not None and value not in servo_models():
            raise ValueError(
                f"there is no control table for model {model_text(value)}; expected {models_text()}"
            )
        return value

    @field_validator("watchdog_s")
    @classmethod
    def _whole_steps(cls, value: float) -> float:
        steps = value / WATCHDOG_STEP_S
        if abs(steps - round(steps)) > 1e-6:
            raise ValueError(f"watchdog_s {value} is not a multiple of {WATCHDOG_STEP_S} s")
        return value

    @field_validator("drive_registers", "steer_registers")
    @classmethod
    def _ram_only(cls, value: dict[str, int], info: ValidationInfo) -> dict[str, int]:
        models = servo_models()
        number = info.data.get("model_number")
        possible = tuple(models.values()) if number is None else (models[number],)
        for name, raw in value.items():
            for model in possible:
                problem = _ram_problem(model, name, raw)
                if problem:
                    raise ValueError(problem)
        return value

    @model_validator(mode="after")
    def _check(self) -> ServosConfig:
        if len(set(self.ids)) != 8:
            raise ValueError("drive_ids and steer_ids must be eight different IDs")
        if self.steer_mode == "position" and self.steer_limit_rad > 3.14:
            raise ValueError("steer_limit_rad beyond 3.14 needs steer_mode extended")
        return self


def _ram_problem(model: ServoModel, name: str, raw: int) -> str:
    """Why a bench may not have a register of a model written at open; empty where it may.

    Args:
        model: model of the servo, with its control table.
        name: name of the register.
        raw: count to write.
    """
    register = model.table.get(name)
    if register is None or name.startswith("indirect"):
        return f"{name} is not a register that can be set here; see hil/config/servo_models"
    if register.eeprom:
        return f"{name} is in the EEPROM: write it with `hil setup`"
    if not register.writable or name in _OWNED:
        return f"{name} is read-only or belongs to the driver"
    return "" if register.permits(raw) else f"{name} = {raw}, expected {register.range_text()}"
