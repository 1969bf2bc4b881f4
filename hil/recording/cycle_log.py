"""The cycles of a running drive: the newest in memory, all others on disk, and their numbers as arrays."""

import logging
import os
import tempfile
import weakref
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, overload

import msgspec

from hil.core.device import DeviceKind
from hil.core.errors import HilError
from hil.core.signals import CycleRecord
from hil.loop.driven_motion import Motion
from hil.loop.motion_columns import MotionColumns
from hil.recording.columns_on_disk import ColumnsOnDisk, Stretch
from hil.recording.cycle_codec import CycleCodec

_LOG = logging.getLogger(__name__)
_BLOCK, _KEPT_BLOCKS = 250, 8
"""Cycles of a block, and number of full blocks that stay in memory: 20 s at 100 Hz."""
_DISK = "/var/tmp"  # /tmp is memory on some systems

Block = list[CycleRecord] | tuple[int, int]
"""Records, or offset and length of the block in the file."""


class CycleLog(Sequence[CycleRecord]):
    """Cycle records in the order in which they were appended.

    A block that cannot be recorded (`CycleCodec`), or that the disk does not take, stays in memory.

    Args:
        added: kinds of other packages whose samples the records may hold.
    """

    def __init__(self, added: tuple[DeviceKind, ...] = ()) -> None:
        self._added = added
        self._codec: CycleCodec | None = None
        self._blocks: list[Block] = [[]]
        self._columns: list[MotionColumns] = []
        self._rows: list[Stretch] = []
        self._diagnostics: list[Stretch] = []
        self._length, self._stuck = 0, False
        self._file: Any = None
        self._newest: list[CycleRecord] = self._blocks[0]  # type: ignore[assignment]
        self._loaded: tuple[int, list[CycleRecord]] = (-1, [])

    def append(self, record: CycleRecord) -> None:
        """Append a record; now and then the oldest block in memory goes to the disk."""
        if len(self._newest) == _BLOCK:
            self._newest = []
            self._blocks.append(self._newest)
            if len(self._blocks) > _KEPT_BLOCKS + 1:
                self._spill(len(self._blocks) - _KEPT_BLOCKS - 2)
        self._newest.append(record)
        self._length += 1

    def motion(self) -> Motion:
        """The whole drive; the log takes no more records then."""
        for number in range(len(self._columns), len(self._blocks)):
            self._keep(MotionColumns.of(self._block(number)))
        rows, diagnostics = (
            ColumnsOnDisk(stretches, self._file, self) for stretches in (self._rows, self._diagnostics)
        )
        columns = replace(MotionColumns.joined(self._columns), rows=rows, diagnostics=diagnostics)
        for kept in (self._columns, self._rows, self._diagnostics):
            kept.clear()
        return Motion(self, columns)

    def _keep(self, columns: MotionColumns, written: tuple[Stretch, Stretch] | None = None) -> None:
        """Keep the numbers of the next block, or where they were written."""
        if written is None:
            written = Stretch(len(columns), columns.rows), Stretch(len(columns), columns.diagnostics)
        self._rows.append(written[0])
        self._diagnostics.append(written[1])
        self._columns.append(replace(columns, rows={}, diagnostics={}))

    def _spill(self, number: int) -> None:
        """Write a block to the disk, and keep its numbers."""
        records = self._block(number)
        columns, written = MotionColumns.of(records), None
        try:
            if self._codec is None:
                self._codec = CycleCodec(self._added)
            packed = zlib.compress(msgspec.msgpack.encode(list(map(self._codec.encode, records))), 1)
            if self._file is None:
                folder = os.environ.get("TMPDIR") or (_DISK if os.access(_DISK, os.W_OK) else None)
                self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
                weakref.finalize(self, self._file.close)
            at = self._file.seek(0, os.SEEK_END)
            self._file.write(packed)
            rows = Stretch.written(self._file, columns.rows, len(columns))
            written = rows, Stretch.written(self._file, columns.diagnostics, len(columns))
            self._blocks[number] = (at, len(packed))
        except (TypeError, ValueError, OverflowError, OSError, HilError) as error:
            if not self._stuck:
                self._stuck = True
                _LOG.warning("a long drive fills the memory: its cycles cannot leave it (%s)", error)
        self._keep(columns, written)

    def _block(self, number: int) -> list[CycleRecord]:
        """Records of a block; the last one that was read from the disk is kept."""
        block = self._blocks[number]
        if isinstance(block, list):
            return block
        if self._loaded[0] != number:
            at, length = block
            self._file.seek(at)
            packed = msgspec.msgpack.decode(zlib.decompress(self._file.read(length)), type=list[bytes])
            assert self._codec is not None
            self._loaded = number, list(map(self._codec.decode, packed))
        return self._loaded[1]

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[CycleRecord]:
        for number in range(len(self._blocks)):
            yield from self._block(number)

    @overload
    def __getitem__(self, index: int) -> CycleRecord: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[CycleRecord]: ...

    def __getitem__(self, index: int | slice) -> CycleRecord | Sequence[CycleRecord]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(self._length)))
        if not -self._length <= index < self._length:
            raise IndexError(f"cycle {index} of {self._length}")
        number, at = divmod(index % self._length, _BLOCK)
        return self._block(number)[at]

    def __reduce__(self) -> tuple[Any, ...]:
        return tuple, (tuple(self),)
