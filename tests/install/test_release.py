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
