"""Why nobody said a word of a fault: what the matrix states of cells that went on as if nothing had been.

Each entry says which data do not change, who would tell later, or that nobody notices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hil.procedure.faults.judge import CellVerdict
from hil.procedure.faults.movement_bounds import kind_of

UNNOTICED = "nobody notices"
_AT_THE_END = "struck where the way ends: the run was over before it could be judged"
_LOST = "single messages are lost or refused by their check, and the next ones say the same"
_OF_ANY: Mapping[str, str] = {
    "duplicate": "what comes twice counts once",
    "drop": _LOST,
    "truncate": _LOST,
    "corrupt": _LOST,
    "slow": "a stream is judged second by second: told within two seconds of a longer run",
}
"""By fault, of a device whose kind says nothing of it (`DeviceKind.silent_faults`)."""


def why_quiet(device: str, fault: str, moments: Sequence[str] = ("motion",)) -> str:
    """What there is to say of a fault of which nobody has said a word, at these moments."""
    if list(moments) == ["stop"]:
        return _AT_THE_END
    passes = kind_of(device).silent_faults
    return passes.get(fault) or passes.get("*") or _OF_ANY.get(fault, UNNOTICED)


def quiet_rows(verdicts: Sequence[CellVerdict]) -> list[dict[str, Any]]:
    """All that were passed over in silence: `device`, `fault`, `moments` and `why`."""
    cells = [v.cell for v in verdicts if not v.told and not v.why and len(v.cell.specs) == 1]
    found: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        moments = found.setdefault((cell.device, cell.fault), [])
        moments += [cell.moment] if cell.moment not in moments else []
    return [
        {"device": device, "fault": fault, "moments": moments, "why": why_quiet(device, fault, moments)}
        for (device, fault), moments in found.items()
    ]
