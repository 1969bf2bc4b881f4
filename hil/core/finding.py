"""One finding about a bench, as drivers make it and `hil doctor` prints it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from hil.core.errors import HilError

Level = Literal["ok", "warning", "failure"]


@dataclass(frozen=True)
class Finding:
    """Result of one check: what was checked, found and expected, and the remedy.

    Attributes:
        device: name of the device, or `bench`.
        check: name of the check.
        found, expected, remedy: texts.
        frames: call chain in the package's code that failed, as of `hil.core.call_chain.as_json`.
    """

    device: str
    check: str
    level: Level
    found: str
    expected: str = ""
    remedy: str = ""
    frames: tuple[Mapping[str, Any], ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The finding as plain data for JSON."""
        return {key: list(v) if key == "frames" else str(v) for key, v in asdict(self).items()}

    @classmethod
    def of_error(cls, device: str, check: str, error: HilError) -> Finding:
        """Make a finding of level `failure` from an error."""
        from hil.core.call_chain import as_json, chain_of

        frames = tuple(as_json(chain_of(error)))
        return cls(device, check, "failure", error.message, error.expected, error.remedy, frames)
