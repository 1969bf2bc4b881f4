"""The call chain of an exception through the user's own code: procedure, script, device package, own parts.

Frames of this package, of Python and of installed libraries are left out: their arguments come from the
user's code. Frames of an installed package that adds a device are kept: the user may have written it.
"""

import os
import sysconfig
import traceback
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from importlib.metadata import entry_points
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.errors import HilError, error_text, shown_path

_PACKAGE = os.path.realpath(Path(__file__).parents[1])
_SHIPPED = os.path.realpath(os.path.join(_PACKAGE, "procedures"))
_PYTHON = tuple(os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib"))
_INSTALLED = ("site-packages", "dist-packages")
GROUP = "hil.devices"
"""Group of entry points by which an installed package adds kinds and models of devices."""
_FROM_ELSEWHERE = "_hil_frames"
_MOST = 50


class Call(NamedTuple):
    """One call of a chain.

    Attributes:
        file: path, relative if below the current folder, else absolute.
        line: line number, from 1.
        function: name of the function.
        code: source text of the line.
        times: number of identical consecutive frames.
        raised: the exception in one line, in its last frame; else empty.
    """

    file: str
    line: int
    function: str
    code: str
    times: int = 1
    raised: str = ""

    @property
    def call(self) -> tuple[str, int, str]:
        """File, line and function."""
        return self[:3]


def chain_of(error: BaseException, *, shipped: bool = False) -> tuple[Call, ...]:
    """The frames of the user's code, outermost call first, at most 50; empty where there are none.

    The frames of an exception's cause follow its own.

    Args:
        error: the caught exception.
        shipped: True if the procedures of this package count as the user's.
    """
    return tuple(_frames(error, shipped))[-_MOST:]


def keep_chain(error: BaseException) -> None:
    """Store the call chain in an exception, so that it survives the transfer to another process."""
    setattr(error, _FROM_ELSEWHERE, chain_of(error))


def as_json(chain: Iterable[Call]) -> list[dict[str, Any]]:
    """A chain as JSON values; its keys are the attributes of `Call`."""
    return [frame._asdict() for frame in chain]


def in_words(chain: Iterable[Mapping[str, Any]]) -> str:
    """Format a chain from `as_json` like a Python traceback, the last call at the end."""
    lines: list[str] = []
    for frame in chain:
        lines.append(f'  File "{frame["file"]}", line {frame["line"]}, in {frame["function"]}')
        lines += [f"    {frame['code']}"] if frame["code"] else []
        lines += [f"    ({frame['times']} times)"] if frame["times"] > 1 else []
        lines += [f"  {frame['raised']}"] if frame["raised"] else []
    return "\n".join(lines)


def place_of(error: BaseException) -> str:
    """File and line where an exception was raised: the last of the user's code, else the last of all."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if _is_users(frame.filename, shipped=True)]
    last = next(reversed(own or frames), None)
    return "unknown place" if last is None else f"{Path(last.filename).name}, line {last.lineno}"


def _frames(error: BaseException, shipped: bool) -> Iterator[Call]:
    seen: set[int] = set()
    link: BaseException | None = error
    while link is not None and id(link) not in seen:
        seen.add(id(link))
        kept = getattr(link, _FROM_ELSEWHERE, ())
        own = [frame for frame in _own(link, shipped) if frame.call not in {known.call for known in kept}]
        if own and not kept and not isinstance(link, HilError):
            own[-1] = own[-1]._replace(raised=error_text(link))
        yield from own
        yield from kept
        if kept:  # the kept chain includes the causes
            return
        link = link.__cause__ or (None if link.__suppress_context__ else link.__context__)


def _own(error: BaseException, shipped: bool) -> Iterator[Call]:
    """The user's frames of one exception, without its causes."""
    every = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in every if _is_users(frame.filename, shipped)]
    for (file, line, function), same in groupby(own, key=lambda s: (s.filename, s.lineno, s.name)):
        alike = list(same)
        yield Call(shown_path(Path(file)), line or 0, function, alike[0].line or "", len(alike))


@lru_cache(maxsize=512)
def _is_users(file: str, shipped: bool) -> bool:
    """Whether a file is the user's: not of this package, of Python or of a library that adds no device."""
    if file.startswith("<frozen "):
        return False
    whole = os.path.realpath(file)
    if _below(whole, _SHIPPED):
        return shipped
    if _below(whole, _PACKAGE):
        return False
    parts = Path(whole).parts
    place = next((parts.index(name) for name in _INSTALLED if name in parts), None)
    if place is not None:
        return Path(parts[place + 1]).stem in _device_packages()
    return not any(_below(whole, folder) for folder in _PYTHON)


def _below(file: str, folder: str) -> bool:
    return file.startswith(folder + os.sep)


def _device_packages() -> set[str]:
    """Top-level modules of the installed packages that add devices."""
    return {entry.module.partition(".")[0] for entry in entry_points(group=GROUP)}
