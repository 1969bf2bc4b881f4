"""docs/add-your-own-device.md as a reader follows it: files are written, shell blocks run as printed."""

import os
import re
import shlex
import shutil
import subprocess
import sys

import pytest
from installing import ROOT

from hil.devkit import CanModel, DeviceKind, DeviceModel, SerialModel

pytestmark = pytest.mark.real_time

GUIDE = (ROOT / "docs" / "add-your-own-device.md").read_text(encoding="utf-8")
FILES = re.findall(r"^`(my-\w+/[\w.]+)`[^\n]*:\n\n```\w+\n(.*?)^```", GUIDE, re.S | re.M)
BLOCKS = re.findall(r"^```sh\n(.*?)^```", GUIDE, re.S | re.M)
ENDS = re.compile(r"^(.*\S)\s+# ends with (\d+)$", re.M)
PROGRAMS = {"python": "", "hil": "-m hil.cli "}


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """A folder like a checkout with the guide's files in it, and an environment without network."""
    place, target = tmp_path_factory.mktemp("reader"), tmp_path_factory.mktemp("site")
    ignored = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT / "examples", place / "examples", ignore=ignored)
    for name, text in FILES:
        path = place / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    for name, words in PROGRAMS.items():
        program = target / "bin" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {words}"$@"\n')
        program.chmod(0o755)
    (target / "pip.conf").write_text(
        f"[install]\ntarget = {target}\nno-index = true\nno-deps = true\nno-build-isolation = false\n"
    )
    env = {
        **os.environ,
        "PATH": f"{target / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": f"{ROOT}{os.pathsep}{target}",
        "PIP_CONFIG_FILE": str(target / "pip.conf"),
        "PYTEST_ADDOPTS": "-p no:cacheprovider",
    }

    def follow(containing):
        (block,) = [b for b in BLOCKS if containing in b]
        script = ENDS.sub(r"code=0; { \1; } || code=$?; test $code -eq \2", block)
        done = subprocess.run(
            ["bash", "-emc", script], cwd=place, env=env, text=True, capture_output=True, timeout=280
        )
        assert done.returncode == 0, f"{script}\n{done.stdout}{done.stderr}"
        return done.stdout

    return follow


@pytest.fixture(scope="module")
def installed(reader):
    """What the block says that installs the example and looks at it."""
    return reader("pip install ./examples/rangefinder")


@pytest.mark.long
def test_another_model_is_installed_examined_and_keeps_the_contract(reader):
    assert [name for name, _ in FILES if "imu" in name] == [
        "my-imu/pyproject.toml",
        "my-imu/my_imu.py",
        "my-imu/bench.toml",
        "my-imu/test_contract.py",
    ]
    reported = reader("./my-imu")
    assert re.search(r"imu +my_imu +My IMU \(hil-my-imu 0\.1\.0\)", reported)
    assert "imu       gravity: 9.8" in reported
    assert re.search(r"1\d passed", reported)
    assert "failed" not in reported


@pytest.mark.long
def test_a_device_on_the_network_is_examined_found_and_keeps_the_contract(reader):
    reported = reader("./my-gap")
    assert re.search(r"ok +gap +open: model lab_gap, serial L-0042", reported)
    assert re.search(r"\d\d passed", reported)
    assert "FAIL gap" in reported
    found = reader("hil discover --at")
    assert '[gap]\nhost = "127.0.0.1"\nudp_port = ' in found
    assert "# gap: serial number L-0042" in found


@pytest.mark.long
def test_a_kind_of_ones_own_does_all_that_the_guide_says(reader, installed):
    """In the guide's order: one test, because each step uses what the one before it has left."""
    assert re.search(r"rangefinder +tf_luna +.*\(hil-rangefinder 0\.1\.0\)", installed)
    assert "rangefinder distance: 1.8" in installed
    reported = reader("--rerun approach.rrd")
    assert "PASS: approach" in reported
    assert reported.count("identical in") == 2
    reported = reader("--fault rangefinder:off")
    assert "FAIL rangefinder" in reported
    assert "FAIL: approach" in reported
    assert '[rangefinder]\nport = "/dev/' in reader("hil discover --on-stand")


@pytest.mark.long
@pytest.mark.usefixtures("installed")
def test_the_example_passes_its_tests(reader):
    reported = reader("cd examples/rangefinder && python -m pytest")
    assert re.search(r"\d\d passed", reported)
    assert "failed" not in reported


def test_every_block_of_the_guide_is_followed():
    followed = (
        "./my-imu",
        "pip install ./examples/rangefinder",
        "--rerun",
        "--fault rangefinder",
        "hil discover --on-stand",
        "cd examples",
        "./my-battery",
        "./my-canimu",
        "./my-gap",
        "hil discover --at",
    )
    assert [sum(key in block for key in followed) for block in BLOCKS] == [1] * len(followed)


@pytest.mark.parametrize(
    "described", [(DeviceModel, SerialModel, CanModel), (DeviceKind,)], ids=lambda c: c[0].__name__
)
def test_the_guide_has_a_line_for_every_name(described):
    (table,) = re.findall(rf"^### `{described[0].__name__}`\n\n(.*?)\n\n", GUIDE, re.S | re.M)
    reported = [
        name for first in re.findall(r"^\| (`.*?) \|", table, re.M) for name in re.findall(r"`(\w+)`", first)
    ]
    names = {n for c in described for n in {*vars(c), *c.__annotations__} if not n.startswith("_")}
    assert {*reported} - {c.__name__ for c in described} == names


@pytest.mark.parametrize(
    ("place", "found"),
    [pytest.param("./my-battery", "serial 00042", marks=pytest.mark.long), ("./my-canimu", "can_imu")],
)
def test_a_small_device_is_examined_and_keeps_the_contract(place, found, reader):
    reported = reader(place)
    assert found in reported
    assert re.search(r"\d\d passed", reported)
    assert "failed" not in reported
    assert ("battery_low" in reported) == (place == "./my-battery")
