"""Writes the results of the campaign of wrong values: JSON, and a table for people."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.fault_matrix.wrong_values.cases import shown
from hil.fault_matrix.wrong_values.judge import FORCE_SHARE, ODOMETRY_M, OFF_M, OFF_RAD, Verdict
from hil.support.atomic_files import write_text

_OUTCOMES = ("right", "misnamed", "harmless", "unconfirmed", "silent")
_LONGEST = 160
"""Number of characters of a row's text."""


def summary(verdicts: Sequence[Verdict], table: Path) -> dict[str, Any]:
    """Return the JSON of the command."""
    counts = Counter(verdict.outcome for verdict in verdicts)
    return {
        "cases": len(verdicts),
        **{name: counts[name] for name in ("right", "misnamed", "harmless", "unconfirmed")},
        "silent": [
            {"key": v.case.key, "file": v.case.said, "true": v.case.truly, "what": v.what}
            for v in verdicts
            if v.outcome == "silent"
        ],
        "table": str(table),
    }


_HEAD = """# Wrong values in the bench file

One number of the bench file is wrong, and the emulated hardware has the true one. `hil doctor`, a short climb
and, where neither names the key, a quick `bring_up` are run, and the emulated world says what was true:

```sh
hil faults --configuration
```

* **right**: the robot is refused or stopped and held, or the doctor fails, and the key is named, alone
  or among those that no measurement of this bench tells apart.
* **misnamed**: it is refused or stopped, and the key is not named.
* **harmless**: no place, heading, odometry or force differs from that of the right file by more than
  {off_mm:g} mm, {off_rad:g} rad, {odometry_mm:g} mm or {share:.0%}.
* **unconfirmed**: it has an effect, and `hil doctor` lists the key as unconfirmed.
* **silent**: it has an effect, and nothing is said. The command then ends with 1.

{counts}

"""


def write_pages(verdicts: Sequence[Verdict], path: Path) -> None:
    """Write the table of all cases, Markdown; raises `DataError` if it cannot be written."""
    counts = Counter[str](verdict.outcome for verdict in verdicts)
    head = _HEAD.format(
        off_mm=1e3 * OFF_M,
        off_rad=OFF_RAD,
        odometry_mm=1e3 * ODOMETRY_M,
        share=FORCE_SHARE,
        counts=f"{len(verdicts)} cases: " + ", ".join(f"{counts[name]} {name}" for name in _OUTCOMES) + ".",
    )
    rows = ["| key | in the file | true | bench | verdict | named by | what was said or seen |"]
    rows.append("|---|---|---|---|---|---|---|")
    for v in verdicts:
        where = ", ".join(filter(None, (v.case.plant, v.case.bench)))
        what = " ".join(v.what.replace("|", "\\|").split())
        rows.append(
            f"| `{v.case.key}` | {shown(v.case.said)} | {v.case.truly} | {where} | {v.outcome} "
            f"| {', '.join(v.named_by)} | {what[:_LONGEST]}{'...' * (len(what) > _LONGEST)} |"
        )
    write_text(path, head + "\n".join(rows) + "\n")
