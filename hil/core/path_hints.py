"""Names the right command when a path of the wrong kind is given."""

import re
import shlex
from contextlib import suppress
from pathlib import Path

from hil.core.result_names import CAMPAIGN_PAGE, CAMPAIGN_TABLE, RESULT

_MOST_BYTES = 1 << 16
_A_TEST = re.compile(r"^\s*(?:async )?def test_", re.M)


def meant(path: Path) -> str:
    """Hint which command a path is for, e.g. `it is a recording: hil replay a.mcap`; empty if unclear.

    Args:
        path: file or folder; empty text for one that does not exist or cannot be read.
    """
    with suppress(OSError, ValueError):
        return _of_a_folder(path) if path.is_dir() else _of_a_file(path) if path.is_file() else ""
    return ""


def is_tests(path: Path) -> bool:
    """Whether a Python file holds tests for pytest rather than a procedure."""
    with suppress(OSError):
        with path.open("rb") as file:
            text = file.read(_MOST_BYTES).decode("utf-8", "replace")
        return _A_TEST.search(text) is not None and "@procedure" not in text
    return False


def _of_a_file(path: Path) -> str:
    name = shlex.quote(str(path))
    if path.suffix == ".py":
        if is_tests(path):
            return f"it is a file of tests: python -m pytest {name}"
        return f"it is a script: hil run {name}"
    if path.suffix == ".mcap":
        return f"it is a recording: hil replay {name}"
    if path.name.endswith((".csv", ".csv.gz")):
        return f"it is a table: if of a drive, hil replay {name}"
    if path.suffix == ".toml":
        return "it is a TOML file: give a bench with --bench FILE, a calibration with --calibration FILE"
    if (path.parent / RESULT).is_file():
        return f"it belongs to a run: hil report {shlex.quote(str(path.parent))}"
    return ""


def _of_a_folder(path: Path) -> str:
    name = shlex.quote(str(path))
    if (path / RESULT).is_file():
        return f"it holds the results of a run: hil report {name}"
    if (path / CAMPAIGN_TABLE).is_file():
        return f"it holds a campaign: open {shlex.quote(str(path / CAMPAIGN_PAGE))}"
    below = [*path.glob(f"*/{RESULT}"), *path.glob(f"*/*/{RESULT}")]
    if below:
        latest = max(below, key=lambda found: (found.stat().st_mtime_ns, str(found))).parent
        return (
            f"it holds {len(below)} of them; the latest: hil report {shlex.quote(str(latest))}; "
            f"all: hil results list --in {name}"
        )
    return ""
