"""Compact, exact serialisation of `hil.vocabulary.signals.CycleRecord`.

Values are written field by field in the order of the dataclasses, floats as their 64 bits, so a
decoded record equals the encoded one bit for bit (NaN payloads included). Little endian; the layout
is that of `hil.recording.cycle_layout`, the way back is `hil.recording.cycle_decoder`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import cached_property, lru_cache
from types import CodeType
from typing import Any

from hil.recording.cycle_layout import BYTE, MAGIC, describe, record_types
from hil.recording.encoder_source import EncoderSource
from hil.recording.value_encoders import BY_NAME, Parts
from hil.vocabulary.device import DeviceKind
from hil.vocabulary.signals import CycleRecord

DECIDED = ("measurements", "state", "reference", "setpoint", "command", "events", "observers")
"""Fields of a cycle record that the brain makes of its inputs; they follow `inputs` without a gap."""


@lru_cache(maxsize=8)
def _compiled(added: tuple[DeviceKind, ...], decided: bool) -> tuple[CodeType, dict[str, Any]]:
    """Code of a function `encode`, and the constants that it names.

    Args:
        added: kinds of other packages whose samples a record may hold.
        decided: of the fields `DECIDED` alone, or of all.
    """
    layout = describe(added)
    codes = {
        name: {member._value_: BYTE.pack(i) for i, member in enumerate(kind)}
        for name, kind in record_types(added).items()
        if issubclass(kind, Enum)
    }
    source = EncoderSource(layout["classes"], codes)
    fields = layout["classes"][layout["root"]]
    source.function("encode", [field for field in fields if not decided or field[0] in DECIDED])
    return compile(source.text(), "<encoder of cycle records>", "exec"), source.constants


class CycleEncoder:
    """Turns cycle records into bytes.

    Args:
        added: kinds of other packages whose samples they may hold.
    """

    def __init__(self, added: tuple[DeviceKind, ...] = ()) -> None:
        self._added = added
        self._encode = self._function(decided=False)

    def encode(self, record: CycleRecord) -> bytes:
        """Bytes of one record.

        Raises:
            struct.error, AttributeError, TypeError: the record does not follow its type hints.
        """
        parts = [MAGIC]
        self._encode(record, parts)
        return b"".join(parts)

    def decided(self, decision: Any) -> bytes:
        """Bytes of the fields `DECIDED` of anything that has them, as they stand in a record.

        Raises:
            struct.error, AttributeError, TypeError: they do not follow their type hints.
        """
        parts: Parts = []
        self._encode_decided(decision, parts)
        return b"".join(parts)

    @cached_property
    def _encode_decided(self) -> Callable[[Any, Parts], None]:
        return self._function(decided=True)

    def _function(self, *, decided: bool) -> Callable[[Any, Parts], None]:
        """A function of its own: what it remembers of the record before is no other encoder's."""
        code, constants = _compiled(self._added, decided)
        scope: dict[str, Any] = {**BY_NAME, **constants}
        exec(code, scope)  # as `dataclasses` does
        encode: Callable[[Any, Parts], None] = scope["encode"]
        return encode
