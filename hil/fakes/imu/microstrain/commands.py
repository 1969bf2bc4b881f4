"""Commands of the emulated MicroStrain sensor, and the settings that they change."""

import dataclasses
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from hil.core.geometry import Three
from hil.links.mip import fields as f
from hil.links.mip.packets import LARGEST_PAYLOAD, Field, Packet, encode, payload_bytes

_THREE_FLOATS = struct.Struct(">3f")
_SETS = (f.SENSOR_DATA, f.FILTER_DATA, f.SYSTEM_DATA)

Answer = tuple[int, tuple[Field, ...]]
_DONE: Answer = (f.DONE, ())
_INVALID: Answer = (f.INVALID_PARAMETER, ())


@dataclass(frozen=True)
class Settings:
    """The settings that commands change.

    Attributes:
        formats: (descriptor, decimation) pairs by descriptor set.
        streams: descriptor sets that are sent.
        transform_rad: roll, pitch, yaw of the transformation to the vehicle's axes, (3,).
        magnetometer: True if it corrects the heading.
    """

    formats: dict[int, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    streams: frozenset[int] = frozenset(_SETS)
    transform_rad: Three = (0.0, 0.0, 0.0)
    magnetometer: bool = True


class Commands:
    """The part of the firmware that handles commands.

    Args:
        info: identity of the sensor.
        base_rate_hz: rate of its filter.
        saved: settings that it has after power-up.

    Attributes:
        settings, saved: settings in use, and those kept without power.
        idle: True if a command has stopped its stream.
        filter_resets, soft_resets: number of commands for each.
    """

    def __init__(self, info: f.DeviceInfo, base_rate_hz: int, saved: Settings) -> None:
        self._info, self._base_rate_hz = info, base_rate_hz
        self.saved = saved
        self.filter_resets = self.soft_resets = 0
        self.power_up()
        self._known: dict[tuple[int, int], Callable[[bytes], Answer]] = {
            (f.BASE, f.PING): lambda data: _DONE,
            (f.BASE, f.SET_IDLE): self._set_idle,
            (f.BASE, f.DEVICE_INFO): self._device_info,
            (f.BASE, f.DESCRIPTORS): self._descriptors,
            (f.BASE, f.MORE_DESCRIPTORS): lambda data: (f.DONE, (Field(f.MORE_DESCRIPTORS_REPLY),)),
            (f.BASE, f.BUILT_IN_TEST): self._built_in_test,
            (f.BASE, f.RESUME): self._resume,
            (f.BASE, f.SOFT_RESET): self._soft_reset,
            (f.THREE_DM, f.BASE_RATE): self._base_rate,
            (f.THREE_DM, f.MESSAGE_FORMAT): self._message_format,
            (f.THREE_DM, f.STREAM): self._stream,
            (f.THREE_DM, f.SETTINGS): self._keep_settings,
            (f.THREE_DM, f.TRANSFORM): self._transform,
            (f.FILTER, f.FILTER_RESET): self._reset_filter,
            (f.FILTER, f.AIDING): self._aiding,
        }

    def power_up(self) -> None:
        """Set the state that follows power-up."""
        self.settings, self.idle = self.saved, False

    def sent(self) -> tuple[tuple[int, int], ...]:
        """(descriptor, decimation) of the filter data that are sent."""
        settings = self.settings
        return settings.formats.get(f.FILTER_DATA, ()) if f.FILTER_DATA in settings.streams else ()

    def answer(self, packet: Packet) -> bytes:
        """The replies to all commands of a packet: in one packet, or in several where they do not fit."""
        replies: list[list[Field]] = [[]]
        for descriptor, data in packet.fields:
            command = self._known.get((packet.descriptor_set, descriptor))
            code, extra = (f.UNKNOWN_COMMAND, ()) if command is None else command(data)
            reply = [Field(f.ACK, bytes((descriptor, code))), *extra]
            if payload_bytes([*replies[-1], *reply]) > LARGEST_PAYLOAD:
                replies.append([])
            replies[-1] += reply
        return b"".join(encode(packet.descriptor_set, fields) for fields in replies if fields)

    def _set_idle(self, data: bytes) -> Answer:
        self.idle = True
        return _DONE

    def _resume(self, data: bytes) -> Answer:
        self.idle = False
        return _DONE

    def _device_info(self, data: bytes) -> Answer:
        return f.DONE, (Field(f.DEVICE_INFO_REPLY, self._info.to_bytes()),)

    def _descriptors(self, data: bytes) -> Answer:
        """All commands and all data, by descriptor set and descriptor; the second command adds none."""
        known = sorted((*self._known, *((f.FILTER_DATA, one) for one in f.LAYOUTS)))
        return f.DONE, (Field(f.DESCRIPTORS_REPLY, b"".join(map(bytes, known))),)

    def _built_in_test(self, data: bytes) -> Answer:
        return f.DONE, (Field(f.BUILT_IN_TEST_REPLY, bytes(4)),)

    def _soft_reset(self, data: bytes) -> Answer:
        self.soft_resets += 1
        return _DONE

    def _base_rate(self, data: bytes) -> Answer:
        if len(data) != 1 or data[0] not in _SETS:
            return _INVALID
        rate = struct.pack(">BH", data[0], self._base_rate_hz)
        return f.DONE, (Field(f.BASE_RATE_REPLY, rate),)

    def _message_format(self, data: bytes) -> Answer:
        if len(data) < 2 or data[1] not in _SETS:
            return _INVALID
        function, descriptor_set = data[0], data[1]
        formats = self.settings.formats
        if function == f.READ:
            now = f.format_data(descriptor_set, formats.get(descriptor_set, ()))
            return f.DONE, (Field(f.MESSAGE_FORMAT_REPLY, now),)
        entries = f.format_entries(data[2:])
        if function != f.WRITE or entries is None or any(decimation == 0 for _, decimation in entries):
            return _INVALID
        if descriptor_set == f.FILTER_DATA and any(descriptor not in f.LAYOUTS for descriptor, _ in entries):
            return _INVALID
        self._change(formats={**formats, descriptor_set: entries})
        return _DONE

    def _stream(self, data: bytes) -> Answer:
        if len(data) < 2 or data[1] not in _SETS:
            return _INVALID
        streams = self.settings.streams
        if data[0] == f.READ:
            return f.DONE, (Field(f.STREAM_REPLY, bytes((data[1], data[1] in streams))),)
        if data[0] != f.WRITE or len(data) != 3:
            return _INVALID
        self._change(streams=streams | {data[1]} if data[2] else streams - {data[1]})
        return _DONE

    def _keep_settings(self, data: bytes) -> Answer:
        if data == bytes((f.SAVE,)):
            self.saved = self.settings
        elif data == bytes((f.LOAD,)):
            self.settings = self.saved
        elif data == bytes((f.DEFAULT,)):
            self.settings = Settings()
        else:
            return _INVALID
        return _DONE

    def _transform(self, data: bytes) -> Answer:
        if data == bytes((f.READ,)):
            return f.DONE, (Field(f.TRANSFORM_REPLY, _THREE_FLOATS.pack(*self.settings.transform_rad)),)
        if data[:1] != bytes((f.WRITE,)) or len(data) != 1 + _THREE_FLOATS.size:
            return _INVALID
        self._change(transform_rad=_THREE_FLOATS.unpack(data[1:]))
        return self._reset_filter(data)

    def _reset_filter(self, data: bytes) -> Answer:
        self.filter_resets += 1
        return _DONE

    def _aiding(self, data: bytes) -> Answer:
        has_one = self._info.number not in f.WITHOUT_MAGNETOMETER
        if len(data) != 4 or data[0] != f.WRITE or data[1:3] != bytes((0, f.MAGNETOMETER)) or not has_one:
            return _INVALID
        self._change(magnetometer=bool(data[3]))
        return _DONE

    def _change(self, **changed: object) -> None:
        self.settings = dataclasses.replace(self.settings, **changed)  # type: ignore[arg-type]
