"""Saves the state of a commissioning after every procedure, as a whole file, so that it can be resumed."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.core.errors import ConfigError, DataError, reason_of
from hil.core.result_names import COMMISSIONING_TABLE, PASSED
from hil.support.atomic_files import put_whole
from hil.support.file_reading import read_json

DONE = (*PASSED, "SKIPPED")
"""Verdicts of a procedure after which the next one may begin."""


@dataclass
class State:
    """Options of a commissioning and the outcome of each procedure.

    Attributes:
        folder: folder of the commissioning.
        options: bench, seed, form and others; a resumed commissioning must have the same.
        done: outcome by procedure: `verdict`, `folder` (relative), and `why` it was left out or repeated.
        rests_on: dependencies of each passed procedure (`reruns.dependencies_of`).
    """

    folder: Path
    options: dict[str, Any]
    done: dict[str, dict[str, Any]] = field(default_factory=dict)
    rests_on: dict[str, dict[str, Any]] = field(default_factory=dict)

    def passed(self, name: str) -> bool:
        """Whether a procedure was run and has passed; one that was left out may have to run now."""
        return self.done.get(name, {}).get("verdict") in PASSED

    def forget(self, name: str) -> None:
        """Forget that a procedure has passed, because this no longer holds."""
        self.done.pop(name, None)
        self.rests_on.pop(name, None)

    def keep(self, name: str, rests_on: dict[str, Any] | None = None, **facts: Any) -> None:
        """Store the outcome of a procedure.

        Args:
            name: name of the procedure.
            rests_on: its dependencies, if it has passed.
            facts: JSON values.

        Raises:
            DataError: the file cannot be written.
        """
        self.forget(name)
        self.done[name] = facts
        if rests_on is not None:
            self.rests_on[name] = rests_on
        path = self.folder / COMMISSIONING_TABLE
        text = json.dumps({"options": self.options, "done": self.done, "rests_on": self.rests_on}, indent=1)
        try:
            put_whole(path, text.encode())
        except OSError as error:
            raise DataError(str(path), f"cannot be written ({reason_of(error)})") from None


def state_of(folder: Path, options: dict[str, Any], *, resume: bool) -> State:
    """Return the state of a new commissioning, or of the interrupted one in a folder.

    Raises:
        ConfigError: the folder holds another commissioning; there is none to resume, or its options differ.
    """
    path = folder / COMMISSIONING_TABLE
    if not path.exists():
        if resume:
            raise ConfigError(f"{folder}: no commissioning to resume there", remedy="leave --resume out")
        return State(folder, options)
    if not resume:
        raise ConfigError(
            f"{folder}: holds a commissioning", remedy="choose another --out, or --resume to continue it"
        )
    tree = read_json(path)
    if not _is_state(tree):
        raise ConfigError(f"{path}: is no state of a commissioning", remedy="start anew with another --out")
    reported = tree["options"]
    different = [
        f"{key} ({reported.get(key)!r} then, {options[key]!r} now)"
        for key in options
        if reported.get(key) != options[key]
    ]
    if different:
        raise ConfigError(
            f"{path}: the interrupted commissioning differs in {', '.join(different)}",
            remedy="resume with the same options, or start anew",
        )
    return State(folder, options, tree["done"], tree["rests_on"])


def _is_state(tree: Any) -> bool:
    """Whether a JSON value is a saved state, with the dependencies of every passed procedure."""
    try:
        done, rests_on = tree["done"], tree["rests_on"]
        passed = [name for name, facts in done.items() if facts["verdict"] in PASSED]
        whole = all(isinstance(rests_on[name][key], dict) for name in passed for key in ("bench", "parts"))
        return whole and isinstance(tree["options"], dict)
    except (KeyError, TypeError, AttributeError):
        return False
