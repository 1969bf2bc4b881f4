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
EXTRAS = re.search(r"^EXTRAS := (.*)$", MAKEFILE, re.MULTILINE)[1].split()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
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
    optional = PROJECT["project"]["optional-dependencies"]
    groups = [
        PROJECT["project"]["dependencies"],
        PROJECT["build-system"]["requires"],
        *map(optional.get, EXTRAS),
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


def dry_run(*words):
    """What make would run, anew from an empty folder."""
    done = subprocess.run(
        ["make", "--always-make", "--dry-run", *words], cwd=ROOT, text=True, capture_output=True, check=True
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("given", "folder", "by"),
    [
        ((), ".venv/", "-c requirements/ci.lock --require-hashes"),
        (("LOCK=",), ".venv-newest/", "-r pyproject.toml"),
        (("OLDEST=1",), ".venv-oldest/", "--resolution lowest-direct"),
    ],
)
def test_make_takes_what_is_locked_the_newest_or_the_oldest(given, folder, by):
    """In a folder each, so that none is taken for another."""
    installing = [line for line in dry_run(*given, "test") if "install" in line]
    packages = [line for line in installing if "--extra" in line]
    assert len(packages) == 1
    assert by in packages[0]
    assert ("ci.lock" in packages[0]) == (not given)
    assert {path for line in installing for path in re.findall(r"\.venv[a-z-]*/", line)} == {folder}


@pytest.mark.parametrize(
    ("target", "extras"),
    [("demo", {"rerun"}), ("test", set(EXTRAS) - {"lint", "docs"}), ("site", set(EXTRAS) - {"lint"})],
)
def test_a_target_installs_the_extras_that_it_needs_and_no_others(target, extras):
    (packages,) = (line for line in dry_run(*target.split()) if "-r pyproject.toml" in line)
    assert set(re.findall(r"--extra (\w+)", packages)) == extras


def test_what_installs_the_packages_is_locked_itself():
    """It comes by pip with its hash, and brings the others."""
    pip = [line for line in dry_run("demo") if " -m pip " in line]
    assert len(pip) == 1
    assert "--require-hashes" in pip[0]
    assert [name_of(locked) for locked, _ in entries()].count("uv") == 1
