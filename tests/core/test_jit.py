"""Machine code: kept by the state of all sources, lost without harm, reported while made, ended by Ctrl-C."""

import importlib.util
import logging
import os
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import event

from hil.core.errors import Aborted
from hil.support import numba_jit
from hil.support.numba_jit import compile_for, kernel

ROOT = Path(__file__).parents[2]
MODULE = """
from hil.support.numba_jit import inner, kernel

@inner
def added(x):
    return x + 1.5

@kernel
def outer(x):
    return 2.0 * added(x)
"""


def fresh(folder, text=MODULE):
    """A module of kernels that has not been imported before; without a text it is there already."""
    path = folder / "made.py"
    if text is not None:
        path.write_text(text)
    spec = importlib.util.spec_from_file_location("made", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def kept_in(tmp_path, monkeypatch, caplog):
    """Folder in which this process keeps machine code for a while."""
    kinds, ours, watch = ("numba:compile", "numba:run_pass"), numba_jit._watch, numba_jit._Watch()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(numba_jit, "_watch", watch)
    caplog.set_level(logging.WARNING)
    for kind in kinds:
        event.unregister(kind, ours)
        event.register(kind, watch)
    yield tmp_path / "cache"
    for kind in kinds:
        event.unregister(kind, watch)
        event.register(kind, ours)


def from_the_cache(folder, text=MODULE, result=5.0):
    """Whether the kernel was found there; without a text the module is there already."""
    outer = fresh(folder, text).outer
    assert outer(1.0) == result
    return sum(outer.stats.cache_hits.values()) == 1


IN_FORKS = """
import os, pathlib, sys, numba

numba.njit(lambda x: x + 1.0)(1.0)  # what every compilation needs is loaded before the forks

def says():
    sys.stdout.flush()
    if not os.fork():
        from hil.robot.turning import turned
        print(turned(0.5), sum(turned.stats.cache_hits.values()))
        sys.stdout.flush()
        os._exit(0)
    os.wait()

says()
pathlib.Path("hil/core/call_chain.py").write_text("# not imported by the kernel's module")
says()
geometry = pathlib.Path("hil/core/geometry.py")
geometry.write_text(geometry.read_text().replace("return math.pi - (math", "return 0.25 + math.pi - (math"))
says()
"""
TURNING = """
from hil.core import geometry
from hil.support.numba_jit import inner, kernel

wrap = inner(geometry.wrap)

@kernel
def turned(angle_rad):
    return wrap(angle_rad)
"""


def test_a_kernel_is_compiled_anew_when_a_function_in_another_file_changes(tmp_path):
    for room in ("core", "support"):
        shutil.copytree(ROOT / "hil" / room, tmp_path / "hil" / room)
    shutil.copy(ROOT / "hil" / "__init__.py", tmp_path / "hil")
    (tmp_path / "hil" / "robot").mkdir()
    (tmp_path / "hil" / "robot" / "turning.py").write_text(TURNING)
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment["PYTHONPATH"] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", IN_FORKS],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["0.5", "0", "0.5", "1", "0.75", "0"]
    assert any((tmp_path / "hil" / "__pycache__" / "kernels").rglob("*.nbc"))


def test_code_is_kept_for_the_newest_state_of_its_source_in_the_first_home_that_takes_it(
    kept_in, tmp_path, monkeypatch
):
    homes = (tmp_path / "one", tmp_path / "other")
    monkeypatch.setattr(numba_jit, "homes", lambda: homes)
    assert not from_the_cache(tmp_path)
    assert not from_the_cache(tmp_path, MODULE.replace("1.5", "2.50"), 7.0)  # one state of it is kept
    (source,) = homes[0].iterdir()
    assert len(list(source.iterdir())) == 1
    shutil.rmtree(homes[0])
    homes[0].write_text("a file where a folder is needed")
    assert (from_the_cache(tmp_path), from_the_cache(tmp_path)) == (False, True)
    assert any(homes[1].rglob("*.nbc"))


def test_code_that_another_user_compiled_is_used_where_nothing_can_be_written(kept_in, tmp_path):
    folder = Path(tempfile.mkdtemp())  # tmp_path cannot be entered by another user
    try:
        assert not from_the_cache(folder)
        shutil.copytree(kept_in, folder / "cache")
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        numba.config.CACHE_DIR = str(folder / "cache")
        child = os.fork()
        if not child:
            if not os.getuid():
                os.setuid(65534)
            os._exit(0 if from_the_cache(folder, None) else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    finally:
        folder.chmod(0o755)
        shutil.rmtree(folder, ignore_errors=True)


def test_a_full_disk_under_the_cache_is_reported_once_and_ends_nothing(kept_in, tmp_path, caplog):
    outer, before = fresh(tmp_path).outer, resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        assert (outer(1.0), outer(1)) == (5.0, 5.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    (reported,) = caplog.messages
    assert str(kept_in) in reported
    assert "NUMBA_CACHE_DIR" in reported


@pytest.mark.parametrize(("kind", "size"), [("nbi", 0), ("nbi", 100), ("nbc", 100)])
def test_a_broken_off_file_in_the_cache_is_replaced(kept_in, tmp_path, kind, size, caplog):
    assert (from_the_cache(tmp_path), from_the_cache(tmp_path)) == (False, True)
    (file,) = kept_in.rglob(f"*.{kind}")
    os.truncate(file, size)
    assert (from_the_cache(tmp_path), from_the_cache(tmp_path)) == (False, True)
    assert caplog.messages == []


def stop(*_):
    raise Aborted("by a signal")


def test_a_signal_in_the_midst_of_the_cache_ends_the_run_all_the_same(kept_in, tmp_path, monkeypatch, caplog):
    for writing, reading in ((stop, pickle.load), (os.replace, stop)):
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", writing)
            patch.setattr(pickle, "load", reading)
            with pytest.raises(Aborted):
                from_the_cache(tmp_path)
        from_the_cache(tmp_path)
    assert caplog.messages == []


def test_where_nothing_can_be_kept_it_is_reported_once(kept_in, monkeypatch, tmp_path, caplog):
    """Neither where the user said, nor beside the source, nor in the user's cache."""
    for name in ("cache", "__pycache__", "of_the_user"):
        (tmp_path / name).write_text("a file where a folder is needed")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "of_the_user"))
    outer = fresh(tmp_path).outer
    assert caplog.messages == []  # nothing is lost before something was compiled
    assert (outer(1.0), outer(1)) == (5.0, 5.0)
    (reported,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in reported


def test_a_kernel_without_a_file_is_none_to_be_kept(kept_in, caplog):
    exec("def f(x):\n    return x + 1.5", scope := {})
    assert kernel(scope["f"])(1.0) == 2.5
    assert caplog.messages == []


def test_an_inner_function_is_machine_code_in_a_kernel_and_plain_in_python(kept_in, tmp_path):
    made = fresh(tmp_path)
    compile_for(made.outer, 1.0)
    assert len(made.outer.signatures) == 1
    assert (made.outer(3.0), made.added(3.0), numba_jit.kernel(made.added)(3.0)) == (9.0, 4.5, 4.5)
    assert made.added(np.float32(1.0)) == 2.5


def test_a_compilation_that_takes_long_is_reported_with_what_does_it_beforehand(kept_in, monkeypatch, caplog):
    monkeypatch.setattr(numba_jit, "_FIRST_WORD_NS", -1)
    kernel(lambda x: x + 1.0)(1.0)
    (reported,) = caplog.messages
    assert "hil info --compile" in reported


class Strike(event.Listener):
    """Ctrl-C at a certain step of a compilation."""

    def __init__(self, step):
        self.left = step

    def on_start(self, _):
        self.left -= 1
        if self.left == 0:
            signal.raise_signal(signal.SIGINT)

    def on_end(self, _):
        pass


@pytest.fixture
def struck(kept_in):
    """Compiles a kernel, with Ctrl-C at a step and a handler of one's own; the kernel."""
    before = signal.getsignal(signal.SIGINT)

    def compiled(step, handler):
        signal.signal(signal.SIGINT, handler)
        made = kernel(lambda x: x + 1.0)
        try:
            with event.install_listener("numba:run_pass", Strike(step)):
                compile_for(made, 1.0)
        finally:
            assert signal.getsignal(signal.SIGINT) is handler
            assert len(made.signatures) == (0 if sys.exc_info()[0] else 1)
        return made

    yield compiled
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    ("step", "handler", "error"), [(1, signal.default_int_handler, KeyboardInterrupt), (20, stop, Aborted)]
)
def test_an_interrupt_ends_a_compilation(struck, step, handler, error):
    with pytest.raises(error):
        struck(step, handler)
    assert kernel(lambda x: x + 1.0)(1.0) == 2.0


def test_a_handler_that_puts_interrupts_off_is_left_to_it(struck):
    noted = []

    def note(*_):
        noted.append(1)

    assert struck(5, note)(1.0) == 2.0
    assert noted == [1]


PLAIN = """
import numpy as np, hil
with hil.open_bench("emulated", seed=1) as bench:
    motion = bench.observe(0.1, feedback="ekf")
print(*motion.estimate[-1].tolist())
"""


@pytest.mark.long
def test_without_machine_code_everything_runs_as_plain_python():
    poses = []
    for asked in ("0", "1"):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": asked}
        done = subprocess.run(
            [sys.executable, "-c", PLAIN], env=environment, capture_output=True, text=True, timeout=250
        )
        assert done.returncode == 0, done.stderr
        poses.append([float(v) for v in done.stdout.split()])
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-9)
