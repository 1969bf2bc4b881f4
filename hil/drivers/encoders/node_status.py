"""The encoder node's status message, once a second: firmware, frame layout, counters."""

from __future__ import annotations

from typing import Any

import can

from hil.config.encoders import EncodersConfig
from hil.links.dbc_file import load_database

_MESSAGE, _LAYOUT = "NodeStatus", "Layout"
_COUNTERS = {
    "ParityErrors": "words with wrong parity",
    "LateSets": "late sample sets",
    "UnsentFrames": "frames that the bus did not take",
    "TimesOffBus": "times off the bus",
}


class NodeStatus:
    """The latest status frame of a node, read by the DBC.

    Args:
        config: DBC and address of the node; a DBC need not describe a status frame.

    Attributes:
        heard: whether a status frame has come.
        counted: what has been counted since the first status frame, in words.

    Raises:
        DataError: the DBC cannot be read.
    """

    def __init__(self, config: EncodersConfig) -> None:
        found = [m for m in load_database(config.dbc_path).messages if m.name == _MESSAGE]
        self._message: Any = found[0] if found else None
        self._frame_id = found[0].frame_id + config.node_id if found else -1
        self._first: dict[str, int] = {}
        self._latest: dict[str, int] = {}

    def take(self, message: can.Message) -> bool:
        """Use a frame if it is the node's status; returns whether it is."""
        if message.arbitration_id != self._frame_id or message.is_extended_id or message.is_remote_frame:
            return False
        if message.dlc == self._message.length:
            self._latest = self._message.decode(bytes(message.data), decode_choices=False)
            self._first = self._first or self._latest
        return True

    @property
    def heard(self) -> bool:
        """Whether a status frame has come."""
        return bool(self._latest)

    @property
    def firmware(self) -> str:
        """Firmware version of the node; `?` where it does not say."""
        return str(self._latest.get("Firmware", "?"))

    @property
    def rate_hz(self) -> float:
        """Sample sets per second that the node was built for; 0 where it does not say."""
        return float(self._latest.get("Rate", 0))

    @property
    def other_layout(self) -> str:
        """How the node's frames differ from the DBC; empty where they agree or it does not say."""
        if not self._latest or _LAYOUT not in self._latest:
            return ""
        known = next(s for s in self._message.signals if s.name == _LAYOUT).choices or {}
        theirs = self._latest[_LAYOUT]
        if not known or theirs in known:
            return ""
        return f"frames of layout {theirs}, the DBC describes {', '.join(str(k) for k in known)}"

    @property
    def counted(self) -> str:
        """What went wrong at the node since it was first heard, in words; empty for nothing."""
        steps = {k: (self._latest[k] - self._first[k]) % 256 for k in _COUNTERS if k in self._latest}
        return ", ".join(f"{n} {_COUNTERS[k]}" for k, n in steps.items() if n)

    def __str__(self) -> str:
        """Firmware, and why it started."""
        if not self._latest:
            return "the node does not say"
        causes = next((s.choices for s in self._message.signals if s.name == "ResetCause"), None) or {}
        cause = causes.get(self._latest.get("ResetCause", -1), "unknown")
        return f"firmware {self.firmware}, started by {cause}"
