"""No kernel runs with an old version of what it is made of, however that is imported."""

import errno
import importlib
import inspect
import logging
import math
import os
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest

from hil.vocabulary.compiling import on_compiling
from hil.vocabulary.errors import Aborted, StepTimeoutError
from hil.vocabulary.kernels import (
    AVAILABLE,
    compile_for,
    compiled,
    compiled_with_parts,
    entry,
    fingerprint,
    inner,
    not_kept,
    parts,
    plain,
)

INNER = """
from hil.vocabulary.kernels import {kind}

STEP = {added}


@{kind}
def step(x):
    return x + STEP
"""
OUTER = """
from hil.vocabulary.kernels import compiled as machine_code
{how}


@machine_code
def outer(x):
    return {call}
"""
FORMS = {
    "alias": ("from kernels.inner import step as stride", "stride(x)"),
    "through_another": ("from kernels.third import once", "once(x)"),
    "constant": ("from kernels.inner import STEP", "x + STEP"),
}
THIRD = """
from hil.vocabulary.kernels import compiled
from kernels.inner import (
    step,
)


@compiled
def once(x):
    return step(x)
"""


@pytest.fixture
def package(tmp_path):
    """Writes a package `kernels` whose outer kernel adds a number that another file holds."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "third.py").write_text(THIRD)

    def write(form, added, kind):
        how, call = FORMS[form]
        for name, text in (
            ("inner", INNER.format(added=added, kind=kind)),
            ("outer", OUTER.format(how=how, call=call)),
        ):
            path = folder / f"{name}.py"
            if not path.exists() or path.read_text() != text:  # older numba goes by when a file was written
                path.write_text(text)
        return tmp_path

    return write


@pytest.mark.parametrize(
    ("form", "kind"), [("through_another", "compiled"), ("constant", "compiled"), ("alias", "inner")]
)
def test_an_edited_inner_file_changes_what_the_outer_kernel_says(package, form, kind, tmp_path):
    pytest.importorskip("numba")
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
    }

    def says(added):
        package(form, added, kind)
        code = "from kernels.outer import outer; print(outer(1.0), sum(outer.stats.cache_hits.values()))"
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    assert says(1.0) == ["2.0", "0"]
    assert says(1.0) == ["2.0", "1"]
    assert says(7.0) == ["8.0", "0"]


def made(body, **scope):
    """Function `f(x)` of one line, with these globals."""
    exec(f"def f(x):\n    return {body}", scope)
    return scope["f"]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (made("x + 1"), made("x + 2")),
        (made("x + 1"), made("x - 1")),
        (made("x + k", k=1), made("x + k", k=1.0)),
        (made("k[0] + x", k=(0.0, 2.0)), made("k[0] + x", k=(-0.0, 2.0))),
        (made("k[0] + x", k=np.array([1.0])), made("k[0] + x", k=np.array([2.0]))),
        (made("g(x)", g=made("x + 1")), made("g(x)", g=made("x + 2"))),
        (made("g(x)", g=made("h(x)", h=made("x"))), made("g(x)", g=made("h(x)", h=made("-x")))),
        (made("sum([(lambda y: y + 1)(x)])"), made("sum([(lambda y: y + 2)(x)])")),
    ],
)
def test_whatever_a_kernel_is_made_of_is_in_its_fingerprint(one, other):
    assert fingerprint(one) != fingerprint(other)


def test_names_of_files_comments_and_descriptions_are_not():
    scope = {}
    described = "# a comment\n\ndef f(x):\n    'A description.'\n    # another comment\n    return x + {}"
    for added in (1, 2):
        exec(compile(described.format(added), "elsewhere.py", "exec"), scope)
        undescribed = "def f(x):\n    'Another.'\n    return x + 1"
        exec(undescribed, other := {})
        assert (fingerprint(scope["f"]) == fingerprint(other["f"])) is (added == 1)


@pytest.mark.parametrize(
    ("body", "scope", "why"),
    [
        ("later(x)", {}, "f uses later: a kernel stands below what it uses"),
        ("inspect.stack", {"inspect": inspect}, "f uses inspect, a module"),
        ("x + k[0]", {"k": [1.0]}, "f uses k, a list"),
        ("x + k['a']", {"k": {"a": 1.0}}, "f uses k, a dict"),
    ],
)
def test_what_has_no_fingerprint_is_refused_when_the_kernel_is_defined(body, scope, why):
    if not AVAILABLE:
        pytest.skip("numba is not installed")
    with pytest.raises(TypeError, match=why):
        compiled(made(body, **scope))


def test_an_inner_kernel_is_compiled_for_kernels_and_plain_for_python():
    pytest.importorskip("numba")
    halve = inner(made("0.5 * x"))
    outer, of_python = compiled(made("g(x) + 1.0", g=halve)), entry(halve)
    assert (outer(3.0), of_python(3.0), halve(3.0)) == (2.5, 1.5, 1.5)
    assert [len(kernel.signatures) for kernel in (outer, of_python, halve.machine_code)] == [1, 1, 1]
    compile_for(halve, 3)
    assert len(halve.machine_code.signatures) == 2
    assert halve(np.float32(3.0)) == 1.5  # in Python any type will do, and none is compiled for
    assert len(halve.machine_code.signatures) == 2


FULL = """
import resource
from hil.vocabulary.kernels import not_kept
from kernels.outer import outer
from kernels.third import once

resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
print(outer(1.0), once(2.0), bool(not_kept()))
"""


def test_a_full_disk_under_the_cache_is_told_once_and_ends_nothing(package, tmp_path):
    pytest.importorskip("numba")
    package("alias", 1.0, "inner")
    cache, path = tmp_path / "cache", os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", FULL], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["2.0", "3.0", "True"]
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"machine code cannot be kept in {cache}")
    assert line.endswith("make room there, or set NUMBA_CACHE_DIR to a folder that can be written")


@pytest.fixture
def kept_in(tmp_path, monkeypatch, caplog):
    """Folder in which this process keeps machine code for a while."""
    numba = pytest.importorskip("numba")
    folder = tmp_path / "cache"
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder))
    monkeypatch.setattr("hil.vocabulary.kept_code._told", "")
    caplog.set_level(logging.WARNING)
    return folder


def added(x):
    return x + 1.5


def from_the_cache():
    """Whether the kernel was found there."""
    kernel = compiled(added)
    assert kernel(1.0) == 2.5
    return sum(kernel.stats.cache_hits.values()) == 1


@pytest.mark.parametrize("size", [0, 100])
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_a_broken_off_file_in_the_cache_is_replaced(kept_in, kind, size, caplog):
    assert (from_the_cache(), from_the_cache()) == (False, True)
    (file,) = kept_in.glob(f"*/*.{kind}")
    os.truncate(file, size)
    assert (from_the_cache(), from_the_cache()) == (False, True)
    assert caplog.messages == []


def test_a_broken_off_file_that_cannot_be_replaced_ends_nothing(kept_in, monkeypatch, caplog):
    from_the_cache()
    (file,) = kept_in.glob("*/*.nbi")
    os.truncate(file, 0)
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refused)
        assert (from_the_cache(), from_the_cache()) == (False, False)
    (told,) = caplog.messages
    assert told == not_kept()
    assert f"cannot be kept in {file.parent} (Permission denied)" in told
    assert "make room" not in told


def refused(*_):
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


@pytest.mark.parametrize("error", [Aborted("by a signal"), StepTimeoutError("a step", 1.0)])
def test_a_signal_in_the_midst_of_the_cache_ends_the_run_all_the_same(kept_in, monkeypatch, caplog, error):
    def struck(*_):
        raise error

    for writing, reading in ((struck, pickle.load), (os.replace, struck)):
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", writing)
            patch.setattr(pickle, "load", reading)
            with pytest.raises(type(error)):
                from_the_cache()
        from_the_cache()
    assert caplog.messages == []


def test_where_nothing_can_be_kept_it_is_told_once(kept_in, monkeypatch, tmp_path, caplog):
    """Neither where the user said, nor beside the source, nor in the user's cache."""
    for name in ("cache", "__pycache__", "of_the_user"):
        (tmp_path / name).write_text("a file where a folder is needed")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "of_the_user"))
    source, scope = tmp_path / "source.py", {}
    source.write_text("def f(x):\n    return x + 1.5\n")
    exec(compile(source.read_text(), source, "exec"), scope)
    kernel = compiled(scope["f"])
    assert not_kept() == ""  # nothing is lost before something was compiled
    assert (kernel(1.0), kernel(2)) == (2.5, 3.5)
    (told,) = caplog.messages
    assert f"NUMBA_CACHE_DIR ({kept_in}), {tmp_path / '__pycache__'} and the user's cache" in told


def test_a_kernel_without_a_file_is_none_to_be_kept(kept_in, caplog):
    assert compiled(made("x + 1.5"))(1.0) == 2.5
    assert caplog.messages == []


def scattered(x):
    """Sums and products whose order shows in the last bit."""
    total = np.zeros(3)
    for k in range(x.size):
        total += math.sin(x[k]) * x[k : k + 3].sum() / (1.0 + x[k] * x[k])
    return total


def test_little_effort_of_the_compiler_gives_the_same_bits_and_is_asked_for_our_kernels_alone(monkeypatch):
    numba = pytest.importorskip("numba")
    monkeypatch.delenv("NUMBA_OPT", raising=False)
    others, efforts = int(numba.config.OPT), []
    x = np.random.default_rng(0).normal(size=100)
    results = []
    for wanted in (None, "3"):
        if wanted is not None:
            monkeypatch.setenv("NUMBA_OPT", wanted)
        kernel = numba.njit(scattered)
        with on_compiling(lambda: efforts.append(int(numba.config.OPT))):
            compile_for(kernel, x)
        results.append(kernel(x).tobytes())
        assert others == numba.config.OPT
    assert set(efforts) == {1, others}
    assert results == [scattered(x).tobytes()] * 2


class Compiling:
    """Takes as long to compile as it is let."""

    def __init__(self):
        self.begun, self.go = threading.Event(), threading.Event()
        self.thread = threading.Thread(target=compile_for, args=(self,))
        self.thread.start()
        assert self.begun.wait(10)

    def compile(self, types):
        self.begun.set()
        assert self.go.wait(10)

    def end(self):
        self.go.set()
        self.thread.join(10)


def test_two_threads_that_compile_leave_the_compilers_effort_as_it_was(monkeypatch):
    numba = pytest.importorskip("numba")
    monkeypatch.delenv("NUMBA_OPT", raising=False)
    others = int(numba.config.OPT)
    first, second = Compiling(), Compiling()
    first.end()
    assert numba.config.OPT == 1
    second.end()
    assert others == numba.config.OPT


def test_mathematics_needs_no_fingerprint():
    assert fingerprint(made("math.cos(x) + np.pi + abs(x)", math=math, np=np))


def test_the_kernels_of_the_filter_hang_together():
    """The event loop is made of the sensors' kernels, although they are called by number."""
    events, wheels = (importlib.import_module(f"hil.estimator.{n}") for n in ("events", "sensors.wheels"))
    friction = importlib.import_module("hil.estimator.friction")
    used = parts(events.run)
    assert {plain(f) for f in (wheels.observe, wheels.jacobian, friction.creep_twist)} <= used
    assert len({fingerprint(plain(f)) for f in (events.run, events.compare, wheels.observe)}) == 3


def test_the_physics_of_the_plant_is_compiled_with_all_its_parts():
    """Its functions stay plain, so that lists can be put through them, too."""
    pytest.importorskip("numba")
    kernel, joints = (importlib.import_module(f"hil.fakes.plant.{n}") for n in ("kernel", "joints"))
    assert {f.__module__ for f in parts(kernel.advance)} == {kernel.__name__, joints.__name__}
    assert {joints.motor, kernel.solve, kernel.origin_velocity, joints.clip} <= parts(kernel.advance)


def test_a_function_is_compiled_with_the_plain_functions_that_it_calls():
    pytest.importorskip("numba")
    inner = made("x + 1.0")
    assert compiled_with_parts(made("2.0 * g(x)", g=inner))(3.0) == 8.0
    assert inner(1.0) == 2.0


def test_without_numba_there_is_nothing_to_compile():
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "from hil.cli import info\n"
        "info._compile_others()\n"
        "print('through')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["through"]
