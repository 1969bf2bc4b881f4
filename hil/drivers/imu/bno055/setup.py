"""Identity, set-up and learnt offsets of a BNO055, outside its measuring cycle.

All of it but the identification happens in CONFIG mode, which the chip is brought into and out of here.
Failures raise `DeviceError`, those of a `Repair` `ExchangeError`.
"""

from typing import NamedTuple

from hil.config.imu import Bno055Config
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.imu.bno055.calibration import SIZE as CALIBRATION_SIZE
from hil.drivers.imu.bno055.calibration import ImuCalibration
from hil.drivers.imu.bno055.messages import ExchangeError, Link

OPR_MODE = 0x3D
REMEDY = "check power, wiring, baud rate and that the PS1 pin selects UART"
MODES = {"imu": 0x8, "compass": 0x9, "m4g": 0xA, "ndof_fmc_off": 0xB, "ndof": 0xC}

_PAGE, _UNIT_SEL, _POWER, _TRIGGER, _AXIS_MAP, _CALIBRATION = 0x07, 0x3B, 0x3E, 0x3F, 0x41, 0x55
_IDENTITY = bytes((0xA0, 0xFB, 0x32, 0x0F))
_IDENTITY_NAMES = ("chip", "accelerometer", "magnetometer", "gyroscope")
_TO_CONFIG_S, _TO_FUSION_S = 0.020, 0.008
_IDENTIFY_PERIOD_S = 0.05
_SETUP_BUDGET_NS = 250_000_000
_CRYSTAL = 0x80
_WRITES = 3
"""Most writes of a repair in one control cycle."""


class Step(NamedTuple):
    """One write of a set-up, and the pause that the chip needs after it."""

    register: int
    data: bytes
    pause_s: float = 0.0


_LEAVE_FUSION = (Step(_PAGE, b"\x00"), Step(OPR_MODE, b"\x00", _TO_CONFIG_S))


class Repair:
    """A set-up that is done step by step, so that it holds up no control cycle.

    Args:
        link: link to the chip.
        steps: the writes.
        deadline_ns: time after which a failed step raises.
    """

    def __init__(self, link: Link, steps: list[Step], deadline_ns: int) -> None:
        self._link, self._steps, self._deadline_ns, self._due_ns = link, steps, deadline_ns, 0

    def go_on(self, now_ns: int) -> bool:
        """Make the writes that are due; return whether all is done.

        Raises:
            ExchangeError: a write has failed too often.
        """
        for register, data, pause_s in self._steps[:_WRITES]:
            if now_ns < self._due_ns:
                return False
            try:
                self._link.write(register, data, now_ns)
            except ExchangeError:
                if now_ns >= self._deadline_ns:
                    raise
                return False
            del self._steps[0]
            self._due_ns = now_ns + nanoseconds(pause_s)
        return not self._steps and now_ns >= self._due_ns


class Chip:
    """One chip behind an open link.

    Args:
        link: link to the chip.
        config: mode, axes, budgets.
        clock: the bench clock.
        device: name in errors.
        calibration: offsets that every set-up writes, if any.
    """

    def __init__(
        self, link: Link, config: Bno055Config, clock: Clock, device: str, calibration: ImuCalibration | None
    ) -> None:
        self._link, self._config, self._clock, self._device = link, config, clock, device
        self._calibration = calibration

    def identify(self, deadline_ns: int) -> dict[str, str]:
        """Wait for the chip (it may be booting), then compare the identity bytes.

        Raises:
            DeviceTimeoutError: nothing answered until `deadline_ns`.
            DeviceError: something else answered.
        """
        link = self._link
        while True:
            now_ns = self._clock.now_ns()
            try:
                link.write(_PAGE, b"\x00", now_ns)
                data = link.read(0x00, 7, now_ns + nanoseconds(self._config.retry_budget_s))
            except ExchangeError as error:
                if now_ns >= deadline_ns:
                    raise self._failure(error, "no BNO055 answers") from None
            else:
                if data[:4] == _IDENTITY:
                    break
                if now_ns >= deadline_ns:
                    raise self._wrong_identity(data)
            self._clock.sleep_until_ns(now_ns + nanoseconds(_IDENTIFY_PERIOD_S))
        return {
            "model": "BNO055",
            "chip_id": f"0x{data[0]:02X}",
            "firmware": f"{data[5]:x}.{data[4]:02x}",
            "bootloader": f"{data[6]:02x}",
            "port": self._config.port,
        }

    def _wrong_identity(self, data: bytes) -> DeviceError:
        table = ", ".join(
            f"{name} 0x{want:02X} found 0x{have:02X}"
            for name, want, have in zip(_IDENTITY_NAMES, _IDENTITY, data[:4], strict=True)
        )
        return DeviceError(
            self._device,
            "another device answers",
            port=self._config.port,
            expected=table,
            remedy="check the port; the Bosch USB stick speaks another protocol",
        )

    def prepare(self, deadline_ns: int) -> None:
        """Set up and start the fusion for the first time; raises `DeviceError`."""
        try:
            self._set_up(deadline_ns)
        except ExchangeError as error:
            raise self._failure(error, "the BNO055 cannot be set up") from None

    def repair(self) -> Repair:
        """Begin to set up again a chip that has lost its mode, one write at a time."""
        return Repair(self._link, self._steps(), self._clock.now_ns() + _SETUP_BUDGET_NS)

    def _set_up(self, deadline_ns: int) -> None:
        for register, data, pause_s in self._steps():
            self._link.write(register, data, deadline_ns)
            self._wait(pause_s)

    def _steps(self) -> list[Step]:
        """Writes of a set-up: CONFIG mode, units, axes, offsets, then the fusion mode."""
        crystal = [Step(_TRIGGER, bytes((_CRYSTAL,)))] if self._config.external_crystal else []
        learnt = self._calibration
        offsets = [] if learnt is None else [Step(_CALIBRATION, learnt.to_bytes())]
        return [
            *_LEAVE_FUSION,
            Step(_POWER, b"\x00"),
            Step(_UNIT_SEL, b"\x00"),
            *crystal,
            Step(_AXIS_MAP, bytes((self._config.axis_map, self._config.axis_sign))),
            *offsets,
            self._enter_fusion(),
        ]

    def read_offsets(self) -> ImuCalibration:
        """Offsets that the chip has learnt; raises `DeviceError`."""
        deadline_ns = self._clock.now_ns() + _SETUP_BUDGET_NS
        try:
            for register, data, pause_s in _LEAVE_FUSION:
                self._link.write(register, data, deadline_ns)
                self._wait(pause_s)
            found = ImuCalibration.from_bytes(self._link.read(_CALIBRATION, CALIBRATION_SIZE, deadline_ns))
            register, data, pause_s = self._enter_fusion()
            self._link.write(register, data, deadline_ns)
            self._wait(pause_s)
        except ExchangeError as error:
            raise self._failure(error, "the calibration cannot be read") from None
        return found

    def _enter_fusion(self) -> Step:
        return Step(OPR_MODE, bytes((MODES[self._config.fusion_mode],)), _TO_FUSION_S)

    def _wait(self, duration_s: float) -> None:
        self._clock.sleep_until_ns(self._clock.now_ns() + nanoseconds(duration_s))

    def _failure(self, error: ExchangeError, what: str) -> DeviceError:
        kind = DeviceTimeoutError if error.status is Status.TIMEOUT else DeviceError
        return kind(
            self._device,
            f"{what} ({error.reason})",
            port=self._config.port,
            expected=f"replies at {self._config.baud} baud",
            remedy=REMEDY,
        )
