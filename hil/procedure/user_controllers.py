"""Loads the user's own controllers for a bench: classes or functions, `FILE.py:NAME` or `MODULE:NAME`."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from hil.core.errors import UsageError, did_you_mean
from hil.core.interfaces import Controller
from hil.core.known_names import LAWS
from hil.support.user_class import make_named, maker_of

if TYPE_CHECKING:
    from hil.bench.pipelines import BenchModel

_OPTION = "--controller"
_PARTS = {"reset": (), "update": ("state", "reference", "wheels")}


def check_named(named: str) -> None:
    """Check that a named controller can be loaded, before anything is opened; or is a shipped control law.

    Raises:
        UsageError: neither a shipped law nor a name with a colon.
        ConfigError: no such file, module or name, loading fails, or it cannot be called as it will be.
    """
    if named in LAWS:
        return
    if ":" not in named:
        expected = ", ".join(LAWS) + ", or FILE.py:NAME or MODULE:NAME of your own"
        is_file = named.endswith(".py")
        remedy = f"name the class in it, as {named}:NAME" if is_file else did_you_mean(named, LAWS)
        raise UsageError(f"{_OPTION} {named!r} is unknown", expected=expected, remedy=remedy)
    maker_of(named, _OPTION, _PARTS)


def make_own(named: str, bench: BenchModel) -> Controller:
    """Make a controller: call NAME with the bench's model if it takes an argument, else without.

    Raises:
        ConfigError: NAME is refused by `check_named` or fails, or its result lacks `reset` or `update`.
    """
    what = "reset(), and update(state, reference, wheels) that returns a WheelSetpoint"
    return cast("Controller", make_named(named, _OPTION, _PARTS, bench, expected=what))
