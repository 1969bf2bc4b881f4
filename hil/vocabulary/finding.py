"""One thing that a look at a bench has found: what drivers say of themselves, and `hil doctor` prints."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

Level = Literal["ok", "warning", "failure"]


@dataclass(frozen=True)
class Finding:
    """What was looked at, what was found, what would be right, what to do.

    Attributes:
        device: of the bench, or `bench`.
        check: what was looked at.
        found, expected, remedy: in words.
    """

    device: str
    check: str
    level: Level
    found: str
    expected: str = ""
    remedy: str = ""

    def to_json(self) -> dict[str, str]:
        """As plain data."""
        return {key: str(value) for key, value in asdict(self).items()}
