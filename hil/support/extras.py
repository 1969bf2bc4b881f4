"""The extras of the package: their modules, and the line that installs one in this Python.

The line names the packages of an extra, read from the installed metadata. It works however this package
itself was installed: from a folder, a wheel or git.
"""

from __future__ import annotations

import platform
import re
import shlex
import sys
from collections.abc import Iterable
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

    That its module can be imported is not enough: another version may be incompatible. A module that was
    built by hand, because there is no wheel, belongs to no installed package and is accepted.
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
    return ""


def how_to_install(extra: str) -> str:
    """The shell line that adds an extra to this Python, or what the extra needs if that is impossible."""
    wanted = _behind(extra)
    if not wanted:
        return f"install the extra {extra} of {DISTRIBUTION}"
    fitting = [r for r in wanted if _fits(r, extra)]
    if not fitting:
        return f"this Python cannot have the extra {extra}: {_needed(wanted)}"
    names = " ".join(shlex.quote(_plain(r)) for r in fitting)
    python = shlex.quote(sys.executable)
    if util.find_spec("pip") is None:
        return f"install it with: uv pip install --python {python} {names}"
    return f"install it with: {python} -m pip install {names}"


def _behind(extra: str) -> list[Requirement]:
    return [r for r in _requirements() if f'extra == "{extra}"' in str(r.marker)]


def _fits(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})


def _requirements() -> list[Requirement]:
    from packaging.requirements import Requirement

    try:
        found = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        found = []
    return [Requirement(text) for text in found]


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
