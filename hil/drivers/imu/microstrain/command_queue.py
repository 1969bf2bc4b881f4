"""Commands to a MicroStrain sensor and its replies, one at a time, without blocking.

A script yields the commands and takes their replies. A dialogue sends them, repeats those without a reply,
and restarts the script when the sensor stays silent: it may have been switched off.
"""

import math
import struct
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from hil.config.microstrain import BITS_PER_BYTE, MicrostrainConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError
from hil.links.mip import fields as f
from hil.links.mip.packets import LARGEST_BYTES, Field, Packet, PacketParser, encode
from hil.links.serial_port import SerialPort

_TRIES = 5
_LOOK_NS = 1_000_000
_ANGLE_RAD = 1e-4
_TRANSFORM_TRIES = 3
_FARTHEST = 0.1
_THREE_FLOATS = struct.Struct(">3f")
_BASE_RATE = struct.Struct(">BH")


class Command(NamedTuple):
    """One command. `answer` is the descriptor of the data that come with its acknowledgement, if any do."""

    name: str
    descriptor_set: int
    descriptor: int
    data: bytes = b""
    answer: int | None = None


class RefusedError(Exception):
    """The sensor rejects a command; stays inside this package."""

    def __init__(self, command: Command, code: int) -> None:
        super().__init__(f"it refuses {command.name!r} ({f.REFUSALS.get(code, f'code {code}')})")


class UnsuitableError(Exception):
    """Another device answers, or the sensor lacks what the bench file asks; stays inside this package."""

    def __init__(self, message: str, expected: str, remedy: str) -> None:
        super().__init__(message)
        self.expected, self.remedy = expected, remedy


@dataclass(frozen=True)
class SetUp:
    """Identity of a sensor, and its sample rate; NaN where it was only identified."""

    info: f.DeviceInfo
    rate_hz: float


Script: TypeAlias = Generator[Command, bytes, SetUp]


def set_up(config: MicrostrainConfig) -> Script:
    """Silence the sensor, identify it, set what it sends, and start it again.

    Nothing is saved in the sensor: it has its own settings back when it is switched on again.
    """
    yield Command("set to idle", f.BASE, f.SET_IDLE)
    info = _identified((yield Command("device info", f.BASE, f.DEVICE_INFO, answer=f.DEVICE_INFO_REPLY)))
    asked = bytes((f.FILTER_DATA,))
    reply = yield Command("base rate", f.THREE_DM, f.BASE_RATE, asked, f.BASE_RATE_REPLY)
    base_hz = _BASE_RATE.unpack(reply)[1] if len(reply) == _BASE_RATE.size else 0
    decimation = _decimation(base_hz, config.rate_hz)
    yield from _own_axes()
    if info.number not in f.WITHOUT_MAGNETOMETER:
        aiding = struct.pack(">BHB", f.WRITE, f.MAGNETOMETER, config.magnetometer)
        yield Command("magnetometer aiding", f.FILTER, f.AIDING, aiding)
    for other in (f.SENSOR_DATA, f.SYSTEM_DATA):
        yield from _quieted(other)
    entries = tuple((descriptor, decimation) for descriptor in f.LAYOUTS)
    layout = bytes((f.WRITE,)) + f.format_data(f.FILTER_DATA, entries)
    yield Command("message format", f.THREE_DM, f.MESSAGE_FORMAT, layout)
    yield Command("data stream", f.THREE_DM, f.STREAM, bytes((f.WRITE, f.FILTER_DATA, 1)))
    yield Command("resume", f.BASE, f.RESUME)
    return SetUp(info, base_hz / decimation)


def identified() -> Script:
    """Identify the sensor and change nothing; a running stream goes on."""
    info = _identified((yield Command("device info", f.BASE, f.DEVICE_INFO, answer=f.DEVICE_INFO_REPLY)))
    return SetUp(info, math.nan)


def _identified(data: bytes) -> f.DeviceInfo:
    try:
        info = f.DeviceInfo.from_bytes(data)
    except ValueError as error:
        raise UnsuitableError(str(error), "a MicroStrain sensor", "check the port") from None
    if info.number not in f.MODELS:
        known = ", ".join(f"{name} ({number})" for number, name in f.MODELS.items())
        raise UnsuitableError(
            f"another device answers: {info.model or 'no name'} ({info.model_number or 'no number'})",
            f"one of {known}",
            "check the port",
        )
    return info


def _decimation(base_hz: int, wanted_hz: float) -> int:
    """The divisor of the sensor's own rate that comes nearest to `wanted_hz`; raises `UnsuitableError`."""
    decimation = max(1, round(base_hz / wanted_hz))
    if abs(base_hz / decimation - wanted_hz) > _FARTHEST * wanted_hz:
        near = sorted({base_hz / n for n in (max(1, int(base_hz / wanted_hz)), int(base_hz / wanted_hz) + 1)})
        raise UnsuitableError(
            f"it cannot measure at {wanted_hz:g} Hz",
            f"its own {base_hz} Hz divided by a whole number, such as "
            + " or ".join(f"{rate:.1f}" for rate in near),
            "change rate_hz",
        )
    return decimation


def _own_axes() -> Generator[Command, bytes, None]:
    """Have vectors in the axes on the case; written only where they differ, as it restarts the filter."""
    asked = Command("axes", f.THREE_DM, f.TRANSFORM, bytes((f.READ,)), f.TRANSFORM_REPLY)
    plain = bytes((f.WRITE,)) + _THREE_FLOATS.pack(0.0, 0.0, 0.0)
    for _ in range(_TRANSFORM_TRIES):
        reply = yield asked
        if len(reply) == _THREE_FLOATS.size and max(map(abs, _THREE_FLOATS.unpack(reply))) < _ANGLE_RAD:
            return
        yield Command("axes", f.THREE_DM, f.TRANSFORM, plain)
    raise UnsuitableError(
        "it goes on turning its data into other axes", "data in the axes on the case", "update its firmware"
    )


def _quieted(descriptor_set: int) -> Generator[Command, bytes, None]:
    """Stop the data of a descriptor set; a sensor without that set rejects the command."""
    try:
        yield Command("data stream", f.THREE_DM, f.STREAM, bytes((f.WRITE, descriptor_set, 0)))
    except RefusedError:
        return


class Dialogue:
    """Runs one script.

    Args:
        script: function that makes the script; called again when the sensor has stayed silent.
        send: function that hands bytes to the port.
        patience_ns: longest wait for an answer.

    Attributes:
        result: the script's result; None until it has ended.
        answered: True once the sensor has answered anything.
    """

    def __init__(self, script: Callable[[], Script], send: Callable[[bytes], None], patience_ns: int) -> None:
        self._make, self._send, self._patience_ns = script, send, patience_ns
        self.result: SetUp | None = None
        self.answered = False
        self._begin()

    def _begin(self) -> None:
        self._script = self._make()
        self._next(next(self._script))

    def _next(self, command: Command) -> None:
        self._command = command
        self._tries, self._again_ns = 0, 0

    def take(self, packet: Packet) -> None:
        """Process a packet that has arrived.

        Raises:
            RefusedError, UnsuitableError: the script has failed.
        """
        if packet.descriptor_set != self._command.descriptor_set or self.result is not None:
            return
        code = _acknowledged(packet.fields, self._command)
        if code is None:
            return
        self.answered = True
        try:
            if code != f.DONE:
                self._next(self._script.throw(RefusedError(self._command, code)))
                return
            data = _answer(packet.fields, self._command)
            if data is not None:
                self._next(self._script.send(data))
        except StopIteration as end:
            self.result = end.value

    def advance(self, now_ns: int) -> None:
        """Send what is due at `now_ns`."""
        if self.result is not None or now_ns < self._again_ns:
            return
        if self._tries >= _TRIES:
            self._begin()
        command = self._command
        self._tries, self._again_ns = self._tries + 1, now_ns + self._patience_ns
        self._send(encode(command.descriptor_set, (Field(command.descriptor, command.data),)))


def _acknowledged(found: tuple[Field, ...], command: Command) -> int | None:
    """The code of this command's acknowledgement; None when that is missing."""
    for field in found:
        if field.descriptor == f.ACK and len(field.data) == 2 and field.data[0] == command.descriptor:
            return field.data[1]
    return None


def _answer(found: tuple[Field, ...], command: Command) -> bytes | None:
    """The data that a command requests, empty when it requests none; None when they are missing."""
    if command.answer is None:
        return b""
    return next((field.data for field in found if field.descriptor == command.answer), None)


def longest_packet_ns(config: MicrostrainConfig) -> int:
    """Longest time from the first to the last byte of a packet, ns."""
    return nanoseconds(1.3 * LARGEST_BYTES * BITS_PER_BYTE / config.baud)


def open_port(config: MicrostrainConfig, name: str) -> SerialPort:
    """Port of a sensor; `name` is the device's in errors. Raises `DeviceError`."""
    return SerialPort(
        name, config.port, config.baud, expected="a MicroStrain sensor at a serial port or pyserial URL"
    )


def answers(config: MicrostrainConfig, clock: Clock) -> bool:
    """Whether a MicroStrain sensor is at a port. It is only identified, and keeps its settings."""
    parser, port = PacketParser(longest_packet_ns(config)), None
    end_ns = clock.now_ns() + nanoseconds(config.open_timeout_s)
    try:
        port = open_port(config, "imu")
        dialogue = Dialogue(identified, port.write, nanoseconds(config.reply_timeout_s))
        while dialogue.result is None and (now_ns := clock.now_ns()) < end_ns:
            for packet in parser.feed(port.read_available(), now_ns):
                dialogue.take(packet)
            dialogue.advance(now_ns)
            clock.sleep_until_ns(now_ns + _LOOK_NS)
        return dialogue.result is not None
    except (DeviceError, RefusedError, UnsuitableError):
        return False
    finally:
        if port is not None:
            port.close()
