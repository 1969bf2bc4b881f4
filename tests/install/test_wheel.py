"""The package as a wheel: complete, described, and at work in an empty folder away from the checkout."""

import email
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from numba.core import caching
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[2]
BUILDS = Version(importlib.metadata.version("setuptools")) >= Version("77")
pytestmark = pytest.mark.skipif(not BUILDS, reason="setuptools in this environment is older than 77")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of the files that git knows (or would add), built without a network."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    parts = ("hil", "procedures", "pyproject.toml", "PACKAGE.md", "LICENSE")
    known = ["git", "ls-files", "-co", "--exclude-standard", *parts]
    listed = subprocess.run(known, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    for name in listed:
        if (ROOT / name).exists():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name, follow_symlinks=False)
    build = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(out))
    subprocess.run([sys.executable, *build, str(source)], check=True, capture_output=True)
    (found,) = out.glob("hil_4wis4wid-*.whl")
    inside = [f"hil/{name}" if name.startswith("procedures/") else name for name in listed]
    return found, [name for name in inside if name.startswith("hil/") and name != "hil/procedures"]


def bring_machine_code(folder):
    """Have the unpacked package find what the checkout compiled: numba names folders by where sources are."""
    named = caching.UserProvidedCacheLocator.get_suitable_cache_subpath
    kept = Path("hil", "__pycache__", "kernels")
    for source in (ROOT / "hil").rglob("*.py"):
        copy = folder / source.relative_to(ROOT)
        for state in (ROOT / kept).glob("*"):
            if copy.exists() and (state / named(str(source))).is_dir():
                there = folder / kept / state.name / named(str(copy))
                shutil.copytree(state / named(str(source)), there, dirs_exist_ok=True)
        if copy.exists():  # some versions of numba go by time and size
            shutil.copystat(source, copy)


def test_every_file_of_the_package_is_in_it(wheel):
    with zipfile.ZipFile(wheel[0]) as archive:
        inside = set(archive.namelist())
    assert sorted(set(wheel[1]) - inside) == []
    assert [n for n in inside if n.startswith(("tests", "benchmarks", "docs"))] == []


def test_it_is_described(wheel):
    with zipfile.ZipFile(wheel[0]) as archive:
        (path,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        described = email.message_from_string(archive.read(path).decode())
    assert described["License-Expression"] == "MIT"
    assert described["Description-Content-Type"] == "text/markdown"
    text = described.get_payload()
    assert "hardware-in-the-loop" in text
    assert re.findall(r"\]\((?!https?://)[^)]*\)", text) == []  # a relative link leads nowhere from there


def environment_with(wheel, folder):
    """An environment with the wheel, and of other packages those of this one."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    (there,) = folder.glob("lib/*/site-packages")
    (there / "others.pth").write_text("\n".join(path for path in sys.path if path.endswith("-packages")))
    install = ("-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--quiet", "--no-deps")
    subprocess.run([sys.executable, *install, "--no-index", str(wheel)], check=True)
    bring_machine_code(there)


@pytest.mark.long
def test_a_repository_made_of_the_ci_template_passes_and_keeps_what_a_failed_test_recorded(wheel, tmp_path):
    """Away from the checkout, by the commands of the template; then with a test that fails."""
    project = tmp_path / "my robot"
    ignored = shutil.ignore_patterns("__pycache__", ".pytest_cache", "results")
    shutil.copytree(ROOT / "docs" / "ci-template", project, ignore=ignored)
    environment_with(wheel[0], project / ".venv")
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    path = os.pathsep.join((str(project / ".venv" / "bin"), os.environ["PATH"]))
    environment = {**kept, "PATH": path, "GITHUB_ACTIONS": "true"}

    def ci():
        return subprocess.run(
            ["sh", "ci.sh"], cwd=project, env=environment, capture_output=True, text=True, timeout=280
        )

    where = "import hil; print(hil.__file__)"
    asked = ["python", "-c", where]
    imported = subprocess.run(asked, cwd=project, env=environment, capture_output=True, text=True).stdout
    assert imported.startswith(str(project / ".venv"))
    done = ci()
    assert done.returncode == 0, done.stdout + done.stderr
    assert "::error" not in done.stdout
    (project / "tests" / "test_bench.py").unlink()
    tests, procedure = project / "tests" / "test_my_robot.py", project / "procedures" / "short_line.py"
    tests.write_text(tests.read_text().replace("< 0.006", "< 0.0"))
    procedure.write_text(procedure.read_text().replace("high=20.0", "high=0.0"))
    done = ci()
    assert done.returncode == 1, done.stdout + done.stderr
    assert "::error file=procedures/short_line.py::" in done.stdout
    (folder,) = (project / "results" / "failed").iterdir()
    assert {path.name for path in folder.iterdir()} == {"recording.mcap", "recording.html"}
    assert (project / "results" / "short_line" / "junit.xml").exists()
