"""Why nobody said a word of a fault: what the matrix states of cells that went on as if nothing had been.

Each entry says which data do not change, who would tell later, or that nobody notices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hil.procedure.faults.judging import Verdict, kind_of

UNNOTICED = "nobody notices"
_ANY = "*"
_LATER = "a stream is judged second by second: told within two seconds of a longer run"
_LOST = "single messages are lost or refused by their check, and the next ones say the same"
_AT_THE_END = "struck where the way ends: the run was over before it could be judged"
_WHY: Mapping[tuple[str, str], str] = {
    (_ANY, "duplicate"): "what comes twice counts once",
    (_ANY, "drop"): _LOST,
    (_ANY, "truncate"): _LOST,
    (_ANY, "corrupt"): _LOST,
    (_ANY, "slow"): _LATER,
    ("mocap", "intermittent"): _LATER,
    ("mocap", "delayed"): _LATER,
    ("imu", "jump"): "its own heading is not used: gyro and gravity are",
    ("imu", "slow"): f"{UNNOTICED}: values of a moment ago come as often as new ones would",
    ("imu", "delayed"): f"{UNNOTICED} on a straight way: values of 0.1 s ago carry fresh stamps",
    ("adhesion", "slow"): "reports come less often, and often enough for `safety.adhesion_stale_s`",
    ("adhesion", "delayed"): "reports of a moment ago say the same of a fan that turns steadily",
    ("load_cells", "delayed"): "a force of a moment ago is the same for a fan that turns steadily",
    ("servos", "slow"): "answers come later, and within their time",
    ("thrust", _ANY): "this controller sends nothing back, and the robot is held all the same",
}  # fmt: skip


def why_quiet(device: str, fault: str, moments: Sequence[str] = ("motion",)) -> str:
    """What there is to say of a fault of which nobody has said a word, at these moments."""
    if list(moments) == ["stop"]:
        return _AT_THE_END
    kind = kind_of(device).name
    keys = ((kind, fault), (kind, _ANY), (_ANY, fault))
    return next((_WHY[key] for key in keys if key in _WHY), UNNOTICED)


def quiet_table(verdicts: Sequence[Verdict]) -> list[str]:
    """Lines of the table of all that were passed over in silence; none where there are none."""
    cells = [v.cell for v in verdicts if not v.told and not v.why and len(v.cell.specs) == 1]
    found: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        moments = found.setdefault((cell.device, cell.fault), [])
        moments += [cell.moment] if cell.moment not in moments else []
    return [
        f"| `{device}` | `{fault}` | {', '.join(moments)} | {why_quiet(device, fault, moments)} |\n"
        for (device, fault), moments in found.items()
    ]
