"""Load cells whose counts come in CAN frames, by a DBC file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from hil.config.load_cells import CanCellsConfig
from hil.drivers.can_link import CanLink, remedy_of_silence
from hil.drivers.dbc import load_database
from hil.drivers.load_cells.judging import Judge
from hil.drivers.patience import Usefulness, used_while_closed
from hil.vocabulary.clock import NS_PER_S, Clock
from hil.vocabulary.errors import DataError, DeviceError, DeviceTimeoutError
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.signals import LoadCellSample

_WAIT_S = 0.02
_BITS = 24


class CanCells(Sensor[LoadCellSample]):
    """Two cells behind one CAN node.

    Args:
        config: bus, DBC, scales.
        clock: the bench clock.

    Attributes:
        malformed: frames of the right identifier and the wrong length since `open`.
    """

    name = "load_cells"

    def __init__(self, config: CanCellsConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._link = CanLink(self.name, config, clock)
        self._identity: dict[str, str] = {}
        self._usefulness = Usefulness(config.fail_after_s)
        self._judge = Judge(config)
        self._frame_id = self._length = self.malformed = 0
        self._fields: tuple[_Field, ...] = ()

    def open(self) -> None:
        """Load the DBC, open the bus and wait for a first frame.

        Raises:
            DataError: the DBC cannot be used.
            DeviceError: the bus cannot be opened, or no cell is heard.
        """
        self.close()
        self._frame_id, self._length, self._fields = _layout(self._config)
        self._link.open()
        self._judge, self.malformed = Judge(self._config), 0
        try:
            self._await_first()
        except BaseException:
            self.close()
            raise
        self._link.listen_for(self._sample)
        self._usefulness.begin(self._clock.now_ns())
        self._identity = {
            "model": "HX711",
            "port": self._link.port,
            "dbc": str(self._config.dbc_path),
            "frame": f"0x{self._frame_id:X}",
        }

    def close(self) -> None:
        """Let go of the bus. Idempotent; never raises."""
        self._identity = {}
        self._link.close()

    def identity(self) -> Mapping[str, str]:
        """Bus, DBC and frame; empty while closed."""
        return self._identity

    def read(self) -> tuple[LoadCellSample, ...]:
        """All conversions since the last call, oldest first.

        Raises:
            DeviceError: it is closed.
            DeviceTimeoutError: none came for `fail_after_s`.
        """
        if not self._link.is_open:
            raise used_while_closed(self.name, self._link.port)
        samples: list[LoadCellSample] = self._link.heard()
        now_ns = self._clock.now_ns()
        if lost_ns := self._usefulness.lost_ns(bool(samples), now_ns):
            raise self._silent(lost_ns / NS_PER_S)
        if samples:
            self._link.error = ""
        return tuple(samples)

    def _sample(self, t_ns: int, message: Any, now_ns: int) -> LoadCellSample | None:
        raw = self._counts(message)
        return None if raw is None else self._judge.sample(raw, t_ns, now_ns)

    def _counts(self, message: Any) -> tuple[int, int] | None:
        if message.arbitration_id != self._frame_id or message.is_extended_id:
            return None
        if len(message.data) != self._length:
            self.malformed += 1
            return None
        first, second = self._fields
        return first.take(message.data), second.take(message.data)

    def _await_first(self) -> None:
        heard: set[int] = set()
        tries = math.ceil(self._config.open_timeout_s / _WAIT_S)
        for _ in range(tries):
            for _, message in self._link.take(_WAIT_S):
                if self._counts(message) is not None:
                    return
                heard.add(message.arbitration_id)
        if not heard:
            raise self._silent(self._config.open_timeout_s)
        told = ", ".join(f"0x{i:X}" for i in sorted(heard)[:8])
        raise DeviceError(
            self.name,
            f"no frame of the cells; seen {told}",
            port=self._link.port,
            expected=f"0x{self._frame_id:X} ({self._length} bytes)",
            remedy="check load_cells.dbc and load_cells.node_id",
        )

    def _silent(self, duration_s: float) -> DeviceTimeoutError:
        return DeviceTimeoutError(
            self.name,
            f"no conversion for {duration_s:.1f} s{self._link.told()}",
            port=self._link.port,
            expected=f"{self._config.rate_hz:g} per second",
            remedy=remedy_of_silence(self.name, self._config, "the cells' node"),
        )


class _Field:
    """Where a cell's counts lie in the frame."""

    def __init__(self, order: Any, shift: int) -> None:
        self._order, self._shift = order, shift

    def take(self, data: bytes | bytearray) -> int:
        """The signed counts."""
        value = int.from_bytes(data, self._order) >> self._shift & (1 << _BITS) - 1
        return value - (1 << _BITS) if value >> (_BITS - 1) else value


def _layout(config: CanCellsConfig) -> tuple[int, int, tuple[_Field, ...]]:
    """Identifier, length and fields; raises `DataError`."""
    path = config.dbc_path
    database = load_database(path)
    for message in database.messages:
        by_name = {signal.name: signal for signal in message.signals}
        if not all(name in by_name for name in config.signals):
            continue
        signals = [by_name[name] for name in config.signals]
        if any(s.length != _BITS or not s.is_signed for s in signals):
            raise DataError(
                str(path),
                f"message {message.name} has counts of another width",
                expected="signed 24-bit counts",
            )
        fields = tuple(_field(s, message.length) for s in signals)
        return message.frame_id + config.node_id, message.length, fields
    raise DataError(
        str(path),
        "no message has both " + " and ".join(config.signals),
        expected="both names of load_cells.signals in one message of the DBC",
        remedy="correct load_cells.signals or load_cells.dbc",
    )


def _field(signal: Any, length: int) -> _Field:
    if signal.byte_order == "little_endian":
        return _Field("little", signal.start)
    from_top = signal.start // 8 * 8 + 7 - signal.start % 8
    return _Field("big", 8 * length - from_top - signal.length)
