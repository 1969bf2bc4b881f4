"""Commands of `hil` as forms of the page, and the command line that a filled form makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

Values = Mapping[str, str]
"""What was filled in, by name of the field; empty fields are left out."""


@dataclass(frozen=True)
class Field:
    """One field of a form.

    Attributes:
        name: as on the command line: an option (`--seed`), an argument, or a parameter of a procedure.
        title: the same for people, without the unit.
        kind: how it is filled in; `flag` is `true` or left out.
        default: as text; shown, and left to the command.
        help: a sentence.
        unit: for people.
        low, high: of a number; `low_open` where `low` itself is not allowed.
        choices: of a choice; of a text what may be meant.
        more: whether it is folded away at first.
    """

    name: str
    title: str
    kind: Literal["text", "number", "integer", "choice", "flag"]
    default: str = ""
    help: str = ""
    unit: str = ""
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    choices: tuple[str, ...] = ()
    more: bool = False


@dataclass(frozen=True)
class Action:
    """Something that can be started.

    Attributes:
        name: unique.
        group: heading that it stands below.
        summary: a sentence.
        fields: of its form.
        words: of the command, after `hil`, from what was filled in.
        problems: what is wrong with what was filled in, by name of the field, empty text for all of it.
    """

    name: str
    group: str
    summary: str
    fields: tuple[Field, ...]
    words: Callable[[Values], tuple[str, ...]]
    problems: Callable[[Values], dict[str, str]]

    def to_json(self) -> dict[str, Any]:
        """As the page gets it."""
        reported = {"name": self.name, "group": self.group, "summary": self.summary}
        return reported | {"fields": [asdict(field) for field in self.fields]}
