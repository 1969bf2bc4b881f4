"""One version everywhere, and a way to a release that the project's own files go."""

import re
from pathlib import Path

from hil import __version__

try:
    import tomllib
except ModuleNotFoundError:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_is_the_same_everywhere():
    assert tomllib.loads(read("pyproject.toml"))["project"]["version"] == __version__
    assert re.search(r"^version: \"?([\d.]+)\"?$", read("CITATION.cff"), re.M)[1] == __version__


def test_ci_builds_the_site_and_the_packages_with_the_targets_that_the_pages_name():
    ran = re.findall(r"^make (\w+)$", read(".ci/run"), re.M)
    assert ran == ["lint", "site", "dist", "notebooks", "test"]
    targets = set(re.findall(r"^([a-z-]+):", read("Makefile"), re.M))
    assert {*ran, *re.findall(r"`?make ([a-z-]+)`?", read("docs/releases.md"))} - {"of"} <= targets


def test_the_container_installs_what_the_page_builds():
    dockerfile = read("docker/Dockerfile")
    assert "docker/dist" in read("docs/installation.md")
    assert "COPY dist/*.whl" in dockerfile
    services = re.findall(r"^  (\w+):$", read("docker/compose.yml"), re.M)
    assert services == ["client"]
    extras = tomllib.loads(read("pyproject.toml"))["project"]["optional-dependencies"]
    assert set(re.findall(r"\[(\w+)\]", dockerfile)) <= set(extras)
