"""Commands of `hil` as forms of the page, and the command line that a filled form makes."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

Values = Mapping[str, str]
"""Filled-in values by name of the field; empty fields are left out."""


@dataclass(frozen=True)
class Field:
    """One field of a form.

    Attributes:
        name: name on the command line: an option (`--seed`), an argument, or a parameter of a procedure.
        title: name for people, without the unit.
        kind: type of input; `flag` is `true` or left out.
        default: default as text; shown only, because the command applies it.
        help: a sentence.
        unit: unit for people.
        low, high: limits of a number; `low_open` where `low` itself is not allowed.
        choices: options of a choice; suggestions for a text.
        more: True if it is collapsed at first.
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
    """A command or procedure that the page can start.

    Attributes:
        name: unique name.
        group: heading that it stands below.
        summary: a sentence.
        fields: fields of its form.
        words: function that makes the words of the command, after `hil`, from the filled-in values.
        problems: errors in the filled-in values by name of the field; an empty name means the whole form.
    """

    name: str
    group: str
    summary: str
    fields: tuple[Field, ...]
    words: Callable[[Values], tuple[str, ...]]
    problems: Callable[[Values], dict[str, str]]

    def to_json(self) -> dict[str, Any]:
        """The action without its functions, as the page receives it."""
        reported = {"name": self.name, "group": self.group, "summary": self.summary}
        return reported | {"fields": [asdict(field) for field in self.fields]}
