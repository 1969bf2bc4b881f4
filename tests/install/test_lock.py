"""The lock holds everything that `make` installs, in versions that pyproject.toml allows, with hashes."""

import re
import subprocess
from pathlib import Path

import pytest
from packaging.requirements import Requirement

try:
    import tomllib
except ModuleNotFoundError:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
LOCK = (ROOT / "requirements" / "ci.lock").read_text(encoding="utf-8")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
MACHINES = ("x86_64", "aarch64")


def entries():
    """(requirement, hashes) of every entry."""
    found = re.split(r"^(?=[A-Za-z0-9])", LOCK, flags=re.MULTILINE)[1:]
    return [
        (Requirement(e.split("\\\n")[0]), re.findall(r"--hash=sha256:([0-9a-f]{64})\b", e)) for e in found
    ]


def environment(python, machine):
    return {
        "python_version": python,
        "python_full_version": f"{python}.5",
        "sys_platform": "linux",
        "platform_system": "Linux",
        "platform_machine": machine,
        "os_name": "posix",
        "extra": "",
        "implementation_name": "cpython",
        "platform_python_implementation": "CPython",
    }


def holds(requirement, python, machine):
    return requirement.marker is None or requirement.marker.evaluate(environment(python, machine))


def wanted():
    extras = re.search(r"^EXTRAS := (.*)$", MAKEFILE, re.MULTILINE)[1].split()
    optional = PROJECT["project"]["optional-dependencies"]
    groups = [
        PROJECT["project"]["dependencies"],
        PROJECT["build-system"]["requires"],
        *map(optional.get, extras),
    ]
    return [Requirement(text) for group in groups for text in group]


def name_of(requirement):
    return re.sub(r"[-_.]+", "-", requirement.name).lower()


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("python", PYTHONS)
def test_every_requirement_is_locked_once_in_a_version_that_satisfies_it(python, machine):
    pinned = {}
    for locked, _ in entries():
        if holds(locked, python, machine):
            (pin,) = locked.specifier
            assert (pin.operator, name_of(locked) in pinned) == ("==", False), locked
            pinned[name_of(locked)] = pin.version
    needed = [r for r in wanted() if holds(r, python, machine)]
    assert len(needed) > 25
    assert [str(r) for r in needed if not r.specifier.contains(pinned.get(name_of(r), "0"))] == []


def test_every_entry_has_hashes_and_none_says_where_to_fetch_it():
    assert [str(r) for r, hashes in entries() if not hashes] == []
    assert [str(r) for r, _ in entries() if r.url] == []
    assert "://" not in LOCK
    assert [line for line in LOCK.splitlines() if line.startswith("-")] == []


@pytest.mark.parametrize(
    ("given", "folder", "by"),
    [
        ((), ".venv/", "--require-hashes"),
        (("LOCK=",), ".venv-newest/", "-e '.["),
        (("OLDEST=1",), ".venv-oldest/", "--resolution lowest-direct"),
    ],
)
def test_make_takes_what_is_locked_the_newest_or_the_oldest(given, folder, by):
    """In a folder each, so that none is taken for another."""
    reported = subprocess.run(
        ["make", "--always-make", "--dry-run", *given, "lint"],
        cwd=ROOT,
        text=True,
        capture_output=True,
        check=True,
    ).stdout
    installing = reported[: reported.index("hil info --compile")].splitlines()
    assert any(by in line for line in installing)
    assert {path for line in installing for path in re.findall(r"\.venv[a-z-]*/", line)} == {folder}
