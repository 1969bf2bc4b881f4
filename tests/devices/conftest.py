"""Device packages as a user has them: in folders beside `hil`."""

import importlib
import shutil
import sys
from types import SimpleNamespace

import pytest
from faulty_package import DRIVE, TABLES
from installing import EXAMPLE, install

from hil.cli import main
from hil.config.bench import bench_model
from hil.core.registry import kinds


@pytest.fixture(scope="session")
def rangefinder(tmp_path_factory):
    """A folder into which the example package is installed, from a copy of it."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("installed")
    shutil.copytree(EXAMPLE, source / "rangefinder", ignore=shutil.ignore_patterns("build", "*.egg-info"))
    install(source / "rangefinder", target)
    return target


@pytest.fixture
def forget():
    """Forgets which kinds there are; what a test has made known is forgotten after it."""

    def now():
        importlib.invalidate_caches()
        for cached in (kinds, bench_model):
            cached.cache_clear()

    known = set(sys.modules)
    yield now
    for name in set(sys.modules) - known:
        if name.startswith("hil_"):
            del sys.modules[name]
    now()


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
