"""How many cases are tried, and how a finding is reported so that it can be kept."""

from __future__ import annotations

import hashlib
import os
from collections import deque
from pathlib import Path
from types import TracebackType

_LAST = 20


def how_many(cases: int) -> int:
    """Cases of a long run; `HIL_FUZZ_CASES` in their place."""
    return int(os.environ.get("HIL_FUZZ_CASES", cases))


class Finding:
    """Keeps the latest inputs; when something foreign is raised, says which and writes the last one.

    Args:
        target: whose inputs.
    """

    def __init__(self, target: str) -> None:
        self._target, self._latest = target, deque[bytes](maxlen=_LAST)
        self.cases = 0

    def about(self, data: bytes) -> None:
        """The next input is on its way."""
        self._latest.append(data)
        self.cases += 1

    def __enter__(self) -> Finding:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None or not self._latest or not isinstance(error, Exception):
            return
        last = self._latest[-1]
        folder = Path(os.environ.get("HIL_FUZZ_FINDINGS", "out/fuzz")) / self._target
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / hashlib.sha256(last).hexdigest()[:16]
        path.write_bytes(last)
        (folder / "before.txt").write_text("\n".join(data.hex() for data in self._latest), encoding="ascii")
        print(f"{self._target}, case {self.cases}: {last[:200]!r} (whole: {path}; those before: before.txt)")
