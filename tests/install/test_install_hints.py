"""A missing extra is answered with a shell line that works in this Python, wherever the package came from."""

import importlib.metadata
import platform
import shlex
import subprocess
import sys

import pytest
from packaging.requirements import Requirement

from hil.bench.emulator_process import last_words
from hil.campaign import Case, Row, write_rows
from hil.core.errors import HilError, UsageError
from hil.datasets.export import wheel_table, write_table
from hil.datasets.number_table import numbers_at_once
from hil.drivers.tracker.t265.librealsense_interface import realsense
from hil.links.mavlink.messages import dialect
from hil.support.extras import DISTRIBUTION, how_to_install


def behind(extra):
    """The requirements of an extra that hold for this Python, by the installed metadata."""
    found = map(Requirement, importlib.metadata.requires(DISTRIBUTION))
    return [r for r in found if r.marker and r.marker.evaluate({"extra": extra}) and "extra" in str(r.marker)]


def installed_by(line):
    """What a printed line installs; asserts that it is a whole call of this Python's pip."""
    words = shlex.split(line.split("install it with: ", 1)[1].split("; ")[0])
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    return [Requirement(word) for word in words[4:]]


@pytest.mark.parametrize("extra", ["rerun", "campaign"])
def test_the_line_installs_what_the_extra_stands_for(extra):
    named = installed_by(how_to_install(extra))
    assert [(r.name, r.specifier) for r in named] == [(r.name, r.specifier) for r in behind(extra)]


def test_the_line_is_one_that_pip_understands():
    """`--no-index` with an installed package: pip parses the line and has nothing to fetch."""
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    line = how_to_install("parquet").split("install it with: ")[1]
    done = subprocess.run([*shlex.split(line), "--no-index", "--no-deps"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_extra_for_another_python_says_which(monkeypatch):
    monkeypatch.setattr(
        importlib.metadata, "requires", lambda name: ["camera==1; python_version < '3' and extra == 't265'"]
    )
    said = how_to_install("t265")
    assert "camera is made for Python below 3" in said
    assert platform.python_version() in said


def test_the_last_words_of_a_process_are_its_error_alone():
    said = (
        "hil: compiling the wall\nruns: 1/4, about 3 s left\nhil: bench.toml: 2 problems\n  a: no\n  b: no\n"
    )
    assert last_words(said) == "bench.toml: 2 problems\n  a: no\n  b: no"
    assert last_words("half: 1/2\nKilled\n") == "Killed"
    assert last_words("") == ""


@pytest.fixture
def nothing_importable(monkeypatch):
    for module in ("pyarrow", "pyarrow.parquet", "pyrealsense2", "pymavlink.dialects.v20.common"):
        monkeypatch.setitem(sys.modules, module, None)


def missing_parquet(tmp_path):
    write_table(wheel_table([]), tmp_path / "t.parquet", "parquet")


def missing_t265(tmp_path):
    realsense("tracker")


def missing_mavlink(tmp_path):
    dialect()


@pytest.mark.parametrize(
    ("extra", "use"), [("parquet", missing_parquet), ("t265", missing_t265), ("mavlink", missing_mavlink)]
)
def test_what_needs_an_extra_prints_its_line(nothing_importable, tmp_path, extra, use):
    with pytest.raises(HilError) as refused:
        use(tmp_path)
    assert how_to_install(extra) in str(refused.value)


@pytest.fixture(params=["ImportError", "OSError"])
def broken_pyarrow(tmp_path, monkeypatch, request):
    """A pyarrow that is found, but raises when it is imported."""
    (tmp_path / "pyarrow").mkdir()
    (tmp_path / "pyarrow" / "__init__.py").write_text(f"raise {request.param}('libarrow.so is torn')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pyarrow", raising=False)


def test_tables_are_read_without_a_pyarrow_that_is_broken(broken_pyarrow):
    assert numbers_at_once(b"1,2\n3,4\n", 2).tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_parquet_with_a_broken_pyarrow_says_so(broken_pyarrow, tmp_path):
    with pytest.raises(UsageError, match=r"libarrow.so is torn"):
        missing_parquet(tmp_path)


def test_a_campaign_keeps_no_parquet_where_pyarrow_is_broken(broken_pyarrow, tmp_path):
    write_rows(tmp_path / "rows", Row(Case(0), "", "PASS", 0, 1.0))
    assert not (tmp_path / "rows").exists()


def test_without_pip_the_line_is_for_uv(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    words = shlex.split(how_to_install("parquet").removeprefix("install it with: "))
    assert words[:5] == ["uv", "pip", "install", "--python", sys.executable]
