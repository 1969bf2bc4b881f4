"""`hil info` calls an extra usable only if what is installed fits what the extra asks for."""

import json
import platform
from importlib import metadata, util
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from hil.cli import main
from hil.support import extras

try:
    import tomllib
except ModuleNotFoundError:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
OURS = [
    'camera==2.53.1.*; python_version < "3" and extra == "t265"',
    'rerun-sdk>=0.20; extra == "rerun"',
    'pyarrow==1.*; extra == "parquet"',
]
VERSIONS = {"camera": "2.59.1", "rerun-sdk": "0.21.0", "pyarrow": "26.0.1"}


@pytest.fixture
def installed(monkeypatch):
    """Another set of packages: everything but pymavlink and distributed."""
    there = {"rerun", "pyarrow", "pyrealsense2"}
    monkeypatch.setattr(metadata, "requires", lambda name: OURS)
    monkeypatch.setattr(extras, "version_of", VERSIONS.__getitem__)
    monkeypatch.setattr(util, "find_spec", lambda name: name in there or None)


def test_each_extra_says_what_it_lacks(installed):
    assert {name: extras.why_unusable(name) for name in extras.MODULES} == {
        "rerun": "",
        "parquet": "pyarrow 26.0.1 is installed; it needs pyarrow==1.*",
        "t265": "this Python cannot have it: camera is made for Python below 3; this is Python "
        f"{platform.python_version()} on {platform.machine()}",
        "mavlink": "not installed",
        "mujoco": "not installed",
        "paper": "not installed",
        "dronecan": "not installed",
        "campaign": "not installed",
        "gamepad": "not installed",
        "ros2": "not installed",
    }


def test_a_library_built_by_hand_where_there_is_no_wheel_is_usable(installed, monkeypatch):
    monkeypatch.setattr(extras, "version_of", lambda name: extras.ABSENT)
    assert extras.why_unusable("t265") == ""


@pytest.fixture
def torn(tmp_path, monkeypatch):
    """A package as an upgrade can leave it: the part that took over its files has lost them."""
    texts = {
        extras.DISTRIBUTION: ['engine>=3; extra == "mujoco"'],
        "engine": ["engine-core==4.0", "numpy"],
        "engine-core": [],
    }
    for name, files in (
        ("engine", ["mujoco/__init__.py"]),
        ("engine_core", ["mujoco/_specs.so", "mujoco/a.pyc"]),
    ):
        folder = tmp_path / f"{name}-4.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: 4.0\n"
        )
        (folder / "RECORD").write_text("".join(f"{file},sha256=x,1\n" for file in files))
    (tmp_path / "mujoco").mkdir()
    (tmp_path / "mujoco" / "__init__.py").write_text("import mujoco._specs\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(metadata, "requires", texts.__getitem__)


def test_a_package_that_an_upgrade_has_torn_is_unusable_and_installed_once_more(torn):
    assert extras.why_unusable("mujoco") == "engine-core 4.0 lacks 1 of its files (mujoco/_specs.so)"
    line = extras.how_to_install("mujoco")
    assert line.endswith("-m pip install --force-reinstall --no-deps engine-core==4.0")
    assert extras.how_to_install("mujoco", again=True).endswith(" engine==4.0 engine-core==4.0")


def test_info_reports_it(capsys, monkeypatch):
    monkeypatch.setattr("hil.cli.info.why_unusable", lambda name: "not today" if name == "t265" else "")
    assert main(["info", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["extras"] == dict.fromkeys(extras.MODULES, True) | {"t265": False}
    assert found["extras_lack"] == {"t265": "not today"}
    assert main(["info"]) == 0
    reported = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["t265", "no:", "not", "today"] in reported
    assert ["rerun", "yes"] in reported


def test_info_names_every_package_that_this_python_takes_from_the_distribution(capsys):
    """What only tests, lint or the pages need is left out, and so is what another Python needs."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extra = project["optional-dependencies"]
    asked = map(Requirement, [*project["dependencies"], *(r for name in extras.MODULES for r in extra[name])])
    wanted = {r.name for r in asked if r.marker is None or r.marker.evaluate()}
    assert main(["info", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["packages"]
    assert set(reported) == wanted
    assert {"rich", "jinja2", "msgpack", "packaging", "pymavlink", "dronecan", "dask"} <= wanted
    assert "ruff" not in wanted
    assert "absent" not in {reported[name] for name in ("numpy", "rich", "msgpack")}
