"""The filter's machine code from nothing: two processes compile it, one that is kept is loaded by one."""

import contextlib
import signal
import subprocess
import sys

import numpy as np
import pytest

from hil.estimator import ahead
from hil.estimator.unscented import Weights
from hil.vocabulary.compiling import interrupts_heeded
from hil.vocabulary.kernels import compile_for

numba = pytest.importorskip("numba")

HELP = [sys.executable, "-m", "hil.estimator.ahead"]
ONE_FORM_EACH = """
from estimator_drives import drive
from hil.config.estimator import EstimatorConfig
from hil.estimator import ahead, make_estimator
from hil.estimator.events import run
from hil.estimator.unscented import points_of
from hil.robot.kinematics import WheelGeometry

POINTS = [points_of(EstimatorConfig(kind=kind)) for kind in ("ekf", "ukf")]
calls = [call for points in POINTS for call in (*ahead.here(points), *ahead.beside(points))]
for kernel, arguments in calls:
    ahead.compile_for(kernel, *arguments)
cycles = drive(seconds=0.5, seed=3)
for kind in ("ekf", "ukf"):
    estimator = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
    estimator.reset(cycles.start)
    for measurements in cycles.measurements:
        estimator.update(measurements)
for kernel in {run, *(kernel for kernel, _ in calls)}:
    print(kernel.__name__, len(getattr(kernel, "machine_code", kernel).signatures))
"""


@pytest.fixture
def started(monkeypatch):
    """Commands that were started, none of which runs."""
    found = []

    class Nothing:
        def __init__(self, command, **_):
            found.append(command)

        def __enter__(self):
            return self

        def __exit__(self, *error):
            self.wait()

        def wait(self):
            if "waited for" not in found:
                found.append("waited for")

        def kill(self):
            found.append("ended")

    monkeypatch.setattr(subprocess, "Popen", Nothing)
    monkeypatch.setattr(ahead, "here", lambda points: ())
    monkeypatch.setattr(ahead, "_cores", lambda: 2)
    return found


def new_kernel():
    """One that nobody has kept."""
    return numba.njit(lambda a: a + 1.0)


def test_what_is_compiled_ahead_is_what_the_filter_calls(pytestconfig):
    """Each kernel has one form, or one for each filter: another would be compiled beside it, in vain."""
    told = subprocess.run(
        [sys.executable, "-c", ONE_FORM_EACH],
        cwd=pytestconfig.rootpath / "tests" / "estimator",
        capture_output=True,
        text=True,
        check=True,
        timeout=200,
    )
    forms = dict(line.split() for line in told.stdout.splitlines())
    assert len(forms) == 1 + len(ahead.here(None)) + len(ahead.beside(None))
    assert {name for name, count in forms.items() if count != "1"} == {"run", "advance", "moments", "compare"}
    assert set(forms.values()) == {"1", "2"}


@pytest.mark.parametrize(("kind", "points"), [("ekf", None), ("ukf", Weights(1.0, 1.0, 1.0))])
def test_a_process_beside_helps_once_where_there_is_something_to_compile(started, kind, points):
    with ahead.by_halves(points):
        compile_for(new_kernel(), np.zeros(3))
        compile_for(new_kernel(), 1.0)
    assert started == [[*HELP, kind], "waited for"]


def test_a_process_beside_ends_with_one_that_is_interrupted(started):
    def interrupted():
        with ahead.by_halves(None):
            compile_for(new_kernel(), 1.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert started == [[*HELP, "ekf"], "ended", "waited for"]


@pytest.mark.parametrize("then", [RuntimeError("no compiled object yet"), None])
def test_an_interrupt_that_is_lost_on_the_way_is_one_all_the_same(then):
    def lost():
        with interrupts_heeded():
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            if then is not None:
                raise then

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            lost()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_that_is_lost_is_not_put_off_until_all_is_compiled():
    kernel = new_kernel()

    def lost():
        with interrupts_heeded():
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            compile_for(kernel, 1.0)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            lost()
    finally:
        signal.signal(signal.SIGINT, before)
    assert kernel.signatures == []


def test_who_puts_interrupts_off_is_left_to_it(monkeypatch):
    struck = []
    before = signal.signal(signal.SIGINT, lambda *_: struck.append(1))
    try:
        with interrupts_heeded():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert struck == [1]


def test_an_error_without_an_interrupt_stays_what_it_is():
    with pytest.raises(RuntimeError, match="of its own"), interrupts_heeded():
        raise RuntimeError("of its own")


def test_nobody_is_asked_to_help_where_there_is_nothing_to_compile(started):
    kernel = new_kernel()
    compile_for(kernel, 1.0)
    with ahead.by_halves(None):
        compile_for(kernel, 1.0)
    assert started == []


def test_nobody_is_asked_on_a_single_core_or_where_another_helps_already(started, monkeypatch):
    with ahead.by_halves(None, alone=True):
        compile_for(new_kernel(), 1.0)
    monkeypatch.setattr(ahead, "_cores", lambda: 1)
    with ahead.by_halves(None):
        compile_for(new_kernel(), 1.0)
    assert started == []
