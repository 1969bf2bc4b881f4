"""Device packages as a user has them: in folders beside `hil`."""

import importlib
import shutil
import sys
from types import SimpleNamespace

import pytest
import tomllib
from faulty_package import DRIVE, TABLES
from installing import EXAMPLE

from hil.cli import main
from hil.config.bench import bench_model
from hil.core.registry import kinds

CLIMB = """
from hil.procedure import procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line


@procedure(name="climb", needs=("servos", "rangefinder"))
def run(ctx):
    start = enable_hold(ctx.bench)
    ctx.bench.drive(line(start, start + [0.01, 0.0, 0.0], duration_s=0.6), start_pose=start)
"""


@pytest.fixture(scope="session")
def rangefinder(tmp_path_factory):
    """A folder with the example package as pip would install it; tests of the guide have it installed."""
    target = tmp_path_factory.mktemp("installed")
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    shutil.copytree(EXAMPLE / "src" / "hil_rangefinder", target / "hil_rangefinder")
    about = target / "hil_rangefinder-0.1.0.dist-info"
    about.mkdir()
    lines = [f"{key}: {project[key.lower()]}" for key in ("Name", "Version")]
    (about / "METADATA").write_text("\n".join(("Metadata-Version: 2.1", *lines, "")))
    points = [f"{name} = {place}" for name, place in project["entry-points"]["hil.devices"].items()]
    (about / "entry_points.txt").write_text("\n".join(("[hil.devices]", *points, "")))
    return target


def forget_kinds():
    importlib.invalidate_caches()
    for cached in (kinds, bench_model):
        cached.cache_clear()


@pytest.fixture
def forget():
    """Forgets which kinds there are; what a test has made known is forgotten after it."""

    known = set(sys.modules)
    yield forget_kinds
    for name in set(sys.modules) - known:
        if name.startswith("hil_"):
            del sys.modules[name]
    forget_kinds()


@pytest.fixture
def hil(tmp_path, monkeypatch, capsys, forget):
    """Runs the command line, with packages in the given folders beside it."""
    monkeypatch.chdir(tmp_path)
    path = list(sys.path)

    def run(*words, packages=()):
        monkeypatch.setattr(sys, "path", [*map(str, packages), *path])
        forget()
        code = main([str(word) for word in words])
        printed = capsys.readouterr()
        return SimpleNamespace(code=code, out=printed.out, said=printed.err)

    return run


@pytest.fixture(scope="session")
def climb(rangefinder, tmp_path_factory):
    """A results folder of a short drive on the example's bench, made where its package is installed."""
    folder = tmp_path_factory.mktemp("climb")
    script, out = folder / "climb.py", folder / "out"
    script.write_text(CLIMB)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(rangefinder), *sys.path])
        forget_kinds()
        words = ("run", script, "--bench", EXAMPLE / "bench.toml", "--out", out)
        assert main([str(word) for word in words]) == 0
    forget_kinds()
    return out


@pytest.fixture
def package(tmp_path):
    """Makes a folder with an installed package of one module, and entry points into it."""

    def make(name, source, *entries, version="1.0"):
        folder = tmp_path / "packages" / name
        about = folder / f"{name.replace('-', '_')}-{version}.dist-info"
        about.mkdir(parents=True)
        module = name.replace("-", "_")
        (folder / f"{module}.py").write_text(source)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        lines = [f"e{k} = {module}:{entry}" for k, entry in enumerate(entries)]
        (about / "entry_points.txt").write_text("[hil.devices]\n" + "\n".join(lines) + "\n")
        return folder

    return make


@pytest.fixture
def bench(tmp_path):
    """A bench file with the kind `thing`, and a procedure that looks at it, in the current folder."""
    (tmp_path / "bench.toml").write_text(TABLES)
    (tmp_path / "look.py").write_text(DRIVE)
