"""What a kind of device may be called, and what to do where two have one name."""

from __future__ import annotations

import keyword
import re

NAME_RULE = (
    "lower case letters, digits and _ that starts with a letter and is none of all, plant, or Python's words"
)
_NAME = re.compile("[a-z][a-z0-9_]*")
_TAKEN = ("all", "plant", "none")


def is_name(name: object) -> bool:
    """Whether a kind may be called so: `--emulate all` and the fault `plant:...` mean something else."""
    return (
        isinstance(name, str)
        and _NAME.fullmatch(name) is not None
        and name not in _TAKEN
        and not keyword.iskeyword(name)
    )


def after_clash(package: str, what: str) -> str:
    """What to do where the name of a kind or model is taken.

    Args:
        package: that has the name already.
        what: `kind` or `model`.
    """
    if package == "hil":
        return f"give the {what} another name: this one is taken by the package hil"
    return f"uninstall one of the two packages, or give the {what} another name"
