"""Strikes a running procedure at its steps, each strike in a fork of the process that runs it.

One run serves every step and every way to end it: where something moves, the process forks. The
child strikes and goes on to its own end, which is judged there; the parent waits, puts the results
folder back as it was, and runs on undisturbed.
"""

import fcntl
import os
import select
import shutil
import signal
import traceback

import numpy as np
from procedure_runs import Run, assert_still, options_of, watched

from hil.core.interfaces import Sink
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.run_journal import read_journal
from hil.procedure.run_sinks import StepTimer
from hil.procedure.runner import run_procedure
from hil.recording.mcap_reader import read_cycles

EXPECTED = {"exception": 2, "sigterm": 4, "one sigint": 4, "two sigints": 4, "time out": 3}
KILL = "kill -9"
WAYS = (*EXPECTED, KILL)
QUIET_CYCLES = 100
PATIENCE_S = 120.0


class Strikes(Sink):
    """Sink and progress report of one run: reports in which step it is, and strikes there.

    Args:
        folder: results folder of the run.
        ways: in which to strike at each step, each in a child.
        keep: where to leave the results folder of every run that was killed; None for nowhere.
        first: whether to strike only in the first step that moves something, and then to end the run
            that forked by an exception.

    Attributes:
        way: how this process was struck; None in the process that is not.
        struck: (step, way) of every child that ended as it should.
        problems: what went wrong in the others.
    """

    def __init__(self, folder, ways, *, keep=None, first=False):
        self.folder, self._ways, self._keep, self._first = folder, ways, keep, first
        self.benches, self.way = [], None
        self.struck, self.problems, self.steps = [], [], []
        self._open, self._done = [], set()
        self._cycles, self._steering, self._pipe = 0, None, None

    def report(self, what, done, total):
        """Progress of the run; a step in which no loop ran is struck at its end."""
        if total != 1:
            return
        if done == 0:
            self._open.append(what)
            self.steps.append(what)
            self._cycles, self._steering = 0, None
        elif what in self._open:
            if not self._first:
                self._strike_once(looping=False)
            self._open.remove(what)

    def write(self, record):
        """One cycle: strike once something is commanded to move, or when nothing has been for long."""
        self._cycles += 1
        before, self._steering = self._steering, record.setpoint.steering_rad
        rolling = np.abs(record.setpoint.wheel_rate_rad_s).max() > 0.3
        steering = before is not None and np.abs(self._steering - before).max() > 0.02
        quiet_for_long = self._cycles > QUIET_CYCLES and not self._first
        if self._open and (rolling or steering or quiet_for_long):
            self._strike_once(looping=True)

    def close(self):
        pass

    def _strike_once(self, *, looping):
        step = self._open[-1]
        if self.way is not None or step in self._done:
            return
        self._done.add(step)
        for way in self._ways:
            if looping or way != "time out":
                self._branch(step, way)
                if self.way is not None:
                    return
        if self._first:
            raise ZeroDivisionError("sabotage")

    def _branch(self, step, way):
        before = {p: p.read_bytes() for p in self.folder.rglob("*") if p.is_file()}
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            self.way, self._pipe = way, writing
            own_open_files(self.folder)
            self._strike()
            return
        os.close(writing)
        said = heard(reading, child)
        _, status = os.waitpid(child, 0)
        ended = -os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)
        try:
            assert (ended, said) == ((-signal.SIGKILL if way == KILL else 0), "held"), (ended, said)
            if way == KILL:
                self._look_at_what_is_left(step)
            self.struck.append((step, way))
        except Exception:
            self.problems.append(f"{step}, {way}: {traceback.format_exc()}")
        put_back(self.folder, before)

    def _strike(self):
        if self.way == "exception":
            raise ZeroDivisionError("sabotage")
        if self.way == "time out":
            guard = next(s for s in self.benches[-1]._sinks if isinstance(s, StepTimer))
            guard.push_limit("sabotage", 0.05)
        elif self.way == KILL:
            self._die()
        else:
            number = signal.SIGTERM if self.way == "sigterm" else signal.SIGINT
            for _ in range(2 if self.way == "two sigints" else 1):
                os.kill(os.getpid(), number)

    def _die(self):
        """The program is gone from one cycle to the next, the robot is not: look what it does by itself."""
        try:
            assert_still(self.benches)
        except BaseException:
            self.finish(traceback.format_exc())
        os.write(self._pipe, b"held")
        os.kill(os.getpid(), signal.SIGKILL)

    def _look_at_what_is_left(self, step):
        past = read_journal(self.folder / "journal.jsonl")
        for name in past.recordings:
            problems = []
            for _ in read_cycles(self.folder / name, problems):
                pass
            assert all("ends early" in p for p in problems), problems
        assert not (self.folder / "result.json").exists()
        if self._keep is not None:
            shutil.copytree(self.folder, self._keep / f"{len(self.struck):02d}")

    def finish(self, said):
        """End a child."""
        os.write(self._pipe, said.encode()[-4000:])
        os._exit(0 if said == "held" else 1)


def struck(name, folder, parameters, ways, **options):
    """Run a procedure and strike it in children; returns the strikes and the run that forked them."""
    strikes = Strikes(folder, ways, **options)
    used = watched(name, extra_sinks=(strikes,))
    strikes.benches = used.benches
    run_options = options_of(folder, parameters, report=strikes.report)
    try:
        done = Run(run_procedure(load_procedure(name), used, run_options), used)
        if strikes.way is not None:
            check(done, strikes.way)
    except BaseException:
        if strikes.way is None:
            raise
        strikes.finish(traceback.format_exc())
    if strikes.way is not None:
        strikes.finish("held")
    return strikes, done


def check(done, way):
    """What holds after a strike: its exit code, a complete folder, a robot that is held."""
    result = done.result
    assert result.exit_code == EXPECTED[way], result.error
    assert result.verdict.value == ("ABORTED" if EXPECTED[way] == 4 else "ERROR")
    assert not result.teardown_errors
    assert_still(done.source.benches)
    assert (result.folder / "result.json").exists()
    assert (result.folder / "junit.xml").exists()
    read_journal(result.folder / "journal.jsonl")


def own_open_files(folder):
    """Open anew what this process has open in a folder, so that its place in a file is its own."""
    for name in os.listdir("/proc/self/fd"):
        try:
            path = os.readlink(f"/proc/self/fd/{name}")
        except OSError:
            continue
        if path.startswith(f"{folder}/"):
            number = int(name)
            flags = fcntl.fcntl(number, fcntl.F_GETFL) & (os.O_ACCMODE | os.O_APPEND)
            fresh = os.open(path, flags)
            os.lseek(fresh, os.lseek(number, 0, os.SEEK_CUR), os.SEEK_SET)
            os.dup2(fresh, number)
            os.close(fresh)


def put_back(folder, before):
    """Make a folder's files what they were, in place: they may be open."""
    for path in [p for p in folder.rglob("*") if p.is_file()]:
        if path not in before:
            path.unlink()
        elif path.read_bytes() != before[path]:
            with path.open("r+b") as file:
                file.write(before[path])
                file.truncate()


def heard(reading, child):
    """All that a child says until it ends; one that takes too long is ended."""
    said = b""
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        while select.select([pipe], [], [], PATIENCE_S)[0]:
            part = pipe.read(65536)
            if not part:
                return said.decode()
            said += part
    os.kill(child, signal.SIGKILL)
    return f"{said.decode()} took longer than {PATIENCE_S} s"
