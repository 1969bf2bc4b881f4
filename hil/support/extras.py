"""The extras of the package: their modules, and the line that installs one in this Python.

The line names the packages of an extra, read from the installed metadata. It works however this package
itself was installed: from a folder, a wheel or git.
"""

from __future__ import annotations

import os
import platform
import re
import shlex
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import metadata, util
from typing import TYPE_CHECKING

from hil.support.versions import ABSENT, version_of

if TYPE_CHECKING:
    from packaging.requirements import Requirement

DISTRIBUTION = "hil-4wis4wid"
MODULES = {
    "rerun": "rerun",
    "parquet": "pyarrow",
    "t265": "pyrealsense2",
    "mavlink": "pymavlink",
    "dronecan": "dronecan",
    "campaign": "distributed",
    "mujoco": "mujoco",
    "paper": "pymoo",
    "gamepad": "sdl2",
    "ros2": "cyclonedds",
}


_CONDITION = re.compile(r"""(?P<what>\w+)\s*(?P<relation><=|>=|==|!=|<|>)\s*["'](?P<value>[^"']*)["']""")
_RELATIONS = {"<": "below", "<=": "up to", "==": "", "!=": "other than", ">=": "from", ">": "above"}
_WHAT = {
    "python_version": "Python",
    "python_full_version": "Python",
    "platform_machine": "processor",
    "sys_platform": "system",
    "platform_system": "system",
}


def packages() -> tuple[str, ...]:
    """Names of the packages that this one requires in this Python, including its extras for users.

    Empty where the metadata of this package is not installed.
    """
    asked = [r.name for r in _requirements() if any(_fits(r, extra) for extra in MODULES)]
    return tuple(dict.fromkeys(asked))


def is_installed(extra: str) -> bool:
    """Whether the module that an extra brings can be imported."""
    return util.find_spec(MODULES[extra]) is not None


def why_unusable(extra: str) -> str:
    """Why an extra cannot be used in this Python; empty if it can.

    That its module is there is not enough: another version may be incompatible, or files of the package may
    be missing. A module that was built by hand, because there is no wheel, belongs to no installed package
    and is accepted.
    """
    if not is_installed(extra):
        return "not installed"
    wanted = [r for r in _behind(extra) if version_of(r.name) != ABSENT]
    fitting = [r for r in wanted if _fits(r, extra)]
    if wanted and not fitting:
        return f"this Python cannot have it: {_needed(wanted)}"
    for requirement in fitting:
        found = version_of(requirement.name)
        if not requirement.specifier.contains(found, prereleases=True):
            return f"{requirement.name} {found} is installed; it needs {_plain(requirement)}"
    return "; ".join(
        f"{part} {version_of(part)} lacks {len(files)} of its files ({files[0]})"
        for part, files in _torn(fitting).items()
    )


def how_to_install(extra: str, *, again: bool = False) -> str:
    """The shell line that adds an extra to this Python, or what the extra needs if that is impossible.

    Args:
        extra: the extra.
        again: True if what is installed cannot be imported, so that the line installs it once more. A package
            of which files are missing is always installed once more.
    """
    wanted = _behind(extra)
    if not wanted:
        return f"install the extra {extra} of {DISTRIBUTION}"
    fitting = [r for r in wanted if _fits(r, extra)]
    if not fitting:
        return f"this Python cannot have the extra {extra}: {_needed(wanted)}"
    broken = (
        [p for r in fitting for p in _parts(r) if version_of(p) != ABSENT] if again else [*_torn(fitting)]
    )
    wanted_names = [f"{part}=={version_of(part)}" for part in broken] or [_plain(r) for r in fitting]
    names = " ".join(map(shlex.quote, wanted_names))
    python = shlex.quote(sys.executable)
    if util.find_spec("pip") is None:
        return f"install it with: uv pip install {'--reinstall ' if broken else ''}--python {python} {names}"
    forced = "--force-reinstall --no-deps " if broken else ""
    return f"install it with: {python} -m pip install {forced}{names}"


def _torn(requirements: Iterable[Requirement]) -> dict[str, list[str]]:
    """The packages behind requirements of whose recorded files some are not there, with these files.

    An upgrade that moves files from one package to another can leave that: pip installs the new one, and then
    removes the files of the old one.
    """
    found = {part: _missing_files(part) for r in requirements for part in _parts(r)}
    return {part: files for part, files in found.items() if files}


def _parts(requirement: Requirement) -> Iterator[str]:
    """The package of a requirement, and those that it requires in one version: parts of the same product."""
    from packaging.requirements import Requirement

    yield requirement.name
    try:
        texts = metadata.requires(requirement.name) or []
    except metadata.PackageNotFoundError:
        return
    for pinned in (Requirement(text) for text in texts if "==" in text.partition(";")[0]):
        if _fits(pinned, ""):
            yield pinned.name


def _missing_files(package: str) -> list[str]:
    """Files that a package has recorded at its installation and that are not there, but compiled ones."""
    try:
        installed = metadata.distribution(package)
    except metadata.PackageNotFoundError:
        return []
    base = str(installed.locate_file(""))
    names = (line.rsplit(",", 2)[0] for line in (installed.read_text("RECORD") or "").splitlines())
    own = (name for name in names if not name.startswith(("..", '"')) and not name.endswith(".pyc"))
    return [name for name in own if not os.path.exists(os.path.join(base, name))]


def _behind(extra: str) -> list[Requirement]:
    return [r for r in _requirements() if f'extra == "{extra}"' in str(r.marker)]


def _fits(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})


def _requirements() -> list[Requirement]:
    try:
        found = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        found = []
    return list(_parsed(tuple(found)))


@cache
def _parsed(texts: tuple[str, ...]) -> tuple[Requirement, ...]:
    from packaging.requirements import Requirement

    return tuple(map(Requirement, texts))


def _needed(wanted: Iterable[Requirement]) -> str:
    """Python and computer that requirements need, and those present, in words."""
    message = "; ".join(f"{r.name} is made for {_conditions(str(r.marker))}" for r in wanted)
    return f"{message}; this is Python {platform.python_version()} on {platform.machine()}"


def _conditions(marker: str) -> str:
    """The conditions of a marker in plain words; unknown ones stay unchanged."""
    said = []
    for part in re.split(r"\s+and\s+", marker.replace("(", "").replace(")", "")):
        found = _CONDITION.fullmatch(part.strip())
        if found is None:
            said.append(part.strip())
        elif found["what"] != "extra":
            name, relation = _WHAT.get(found["what"], found["what"]), _RELATIONS[found["relation"]]
            said.append(" ".join(filter(None, (name, relation, found["value"]))))
    return " and ".join(said) or "another Python"


def _plain(requirement: Requirement) -> str:
    """A requirement without its conditions."""
    extras = f"[{','.join(sorted(requirement.extras))}]" if requirement.extras else ""
    return f"{requirement.name}{extras}{requirement.specifier}"
