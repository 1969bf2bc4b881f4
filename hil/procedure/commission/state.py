"""How far a commissioning is, on disk: written whole after every procedure, so that it can be resumed."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.vocabulary.errors import ConfigError, DataError
from hil.vocabulary.files import put_whole
from hil.vocabulary.reading import read_json

NAME = "commission.json"
PASSED = ("PASS", "MARGINAL", "SKIPPED")


@dataclass
class State:
    """What was commissioned how, and what became of each procedure.

    Attributes:
        folder: of the commissioning.
        options: bench, seed, form and the like; a resumed one must have the same.
        done: by procedure: `verdict`, `folder` (within this one), `why` of one that was left out.
    """

    folder: Path
    options: dict[str, Any]
    done: dict[str, dict[str, Any]] = field(default_factory=dict)

    def passed(self, name: str) -> bool:
        """Whether a procedure need not run again."""
        return self.done.get(name, {}).get("verdict") in PASSED

    def keep(self, name: str, **facts: Any) -> None:
        """Note what became of a procedure.

        Args:
            name: of the procedure.
            facts: JSON values.

        Raises:
            DataError: the disk does not take it.
        """
        self.done[name] = facts
        path = self.folder / NAME
        text = json.dumps({"options": self.options, "done": self.done}, indent=1)
        try:
            put_whole(path, text.encode())
        except OSError as error:
            raise DataError(str(path), f"cannot be written ({error.strerror or error})") from None


def state_of(folder: Path, options: dict[str, Any], *, resume: bool) -> State:
    """A new commissioning, or the interrupted one in a folder.

    Raises:
        ConfigError: the folder holds another one; or there is none to resume, or with other options.
    """
    path = folder / NAME
    if not path.exists():
        if resume:
            raise ConfigError(f"{folder}: no commissioning to resume there", remedy="leave --resume out")
        return State(folder, options)
    if not resume:
        raise ConfigError(
            f"{folder}: holds a commissioning", remedy="choose another --out, or --resume to continue it"
        )
    tree = read_json(path)
    if not isinstance(tree, dict) or not isinstance(tree.get("done"), dict):
        raise ConfigError(f"{path}: is no state of a commissioning", remedy="start anew with another --out")
    before = tree.get("options")
    told = before if isinstance(before, dict) else {}
    told = {"settings": {}, **told}
    different = [
        f"{key} ({told.get(key)!r} then, {options[key]!r} now)"
        for key in options
        if told.get(key) != options[key]
    ]
    if different:
        raise ConfigError(
            f"{path}: the interrupted commissioning differs in {', '.join(different)}",
            remedy="resume with the same options, or start anew",
        )
    return State(folder, options, tree["done"])
