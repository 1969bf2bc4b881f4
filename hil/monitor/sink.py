"""The monitor as the loop sees it: a bounded queue, and behind it a process that talks to Rerun.

The records go to that process through a pipe, in batches of a tenth of a second, the update interval of the
view. A stalled or dead viewer fills the pipe, then the queue. In real time the oldest records are then
dropped; their number is shown. With `lossless` the caller waits instead, as long as the viewer accepts some.
Rerun may wait for a viewer without end: its process is then killed.
"""

import contextlib
import logging
import os
import pickle
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path

from hil.core.clock import nanoseconds
from hil.core.errors import UsageError, did_you_mean
from hil.core.geometry import Array
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.monitor.record_pipe import READY, Shown, packed, put
from hil.monitor.rerun_viewer import LIVE, check_url, url
from hil.monitor.rrd_file import files_of, what_is_missing
from hil.monitor.scene import Scene
from hil.support.atomic_files import check_file, check_name
from hil.support.extras import how_to_install, is_installed

LOG = logging.getLogger(__name__)

_CAPACITY = 500
_CLOSE_S, _LOSSLESS_S = 4.0, 60.0
_TOGETHER_NS, _MOST_TOGETHER = nanoseconds(0.1), 10
_LEFT_S = 0.5
"""The records that the last cycle of a loop has left in the queue are shown after this time."""


def split_targets(target: str) -> tuple[str, ...]:
    """Outputs of a comma-separated list.

    Raises:
        UsageError: Rerun is not installed; an empty list, a word that is none of them, or another URL.
        DataError: a file that cannot be written.
    """
    if not is_installed("rerun"):
        raise UsageError("the monitor needs Rerun, which is not installed", remedy=how_to_install("rerun"))
    targets = tuple(part for part in (p.strip() for p in target.split(",")) if part)
    expected = "spawn, connect, serve, a rerun+http:// URL or a .rrd file"
    if not targets:
        raise UsageError(f"the monitor cannot open {target!r}", expected=expected)
    for name in targets:
        if name in LIVE:
            continue
        if "://" in name:
            check_url(name)
            continue
        if Path(name).suffix != ".rrd":
            raise UsageError(
                f"the monitor cannot open {name!r}", expected=expected, remedy=did_you_mean(name, LIVE)
            )
        check_name(Path(name), "--rerun")
        check_file(Path(name))
    return targets


class RerunMonitor(Sink):
    """Sink that shows every cycle in Rerun.

    Args:
        target: `spawn`, `connect`, `serve`, a `rerun+http://` URL or a `.rrd` file, or several of
            them separated by commas.
        lossless: True to drop nothing: `write` waits instead (a recording is shown).
        scene: robot and surface to draw; those of the paper when None.
        capacity: cycles that may wait before the oldest is dropped or `write` waits.
        patience_s: longest time of the viewer for the rest when all is over and, where nothing is dropped,
            for some of what waits; 4 s, 60 s where nothing is dropped.

    Attributes:
        dropped: cycles that were not shown.
        failure: reason why the view ended before the run, or its incomplete file; empty for neither.

    Raises:
        UsageError: Rerun is not installed, or the target makes no sense.
    """

    def __init__(
        self,
        target: str,
        *,
        lossless: bool,
        scene: Scene | None = None,
        capacity: int = _CAPACITY,
        patience_s: float | None = None,
    ) -> None:
        targets = split_targets(target)
        self._files = files_of(targets)
        self._viewers = [url() if t in LIVE else t for t in targets if t not in self._files]
        self.dropped = 0
        self.failure = ""
        self._closed = False
        self._capacity, self._lossless = capacity, lossless
        self._patience_s = (_LOSSLESS_S if lossless else _CLOSE_S) if patience_s is None else patience_s
        self._scene = Scene() if scene is None else scene
        self._waiting: deque[Shown] = deque()
        self._in_hand: list[Shown] = []
        self._newest_ns = self._woken_ns = 0
        self._something, self._room = threading.Event(), threading.Event()
        importable = os.pathsep.join(filter(None, sys.path))  # classes of samples are found there, too
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hil.monitor", *targets],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": importable},
            start_new_session=True,
        )
        assert self._process.stdin is not None
        self._pipe = self._process.stdin
        self._await_ready(target)
        self._thread = threading.Thread(target=self._feed, name="monitor", daemon=True)
        self._thread.start()

    def _await_ready(self, target: str) -> None:
        """Wait until the process has loaded Rerun: during the loop its start-up would make cycles late."""
        assert self._process.stdout is not None
        try:
            self._send(pickle.dumps(self._scene))
            ready = any(line == READY for line in iter(self._process.stdout.readline, b""))
        except OSError:
            ready = False
        self._process.stdout.close()
        if not ready:
            self._process.kill()
            self._process.wait()
            raise UsageError(
                f"the monitor's process did not start for {target!r}", remedy="see its message on stderr"
            )

    def write(self, record: CycleRecord) -> None:
        """Take the record of one cycle."""
        if self._closed:
            return
        if len(self._waiting) >= self._capacity and not (self._lossless and self._room_comes()):
            self._drop_oldest()
        self._waiting.append(record)
        self._newest_ns = record.start_ns

    def rest(self) -> None:
        """Wake the thread that sends, ten times a second: it works while the loop sleeps."""
        if self._waiting and not 0 <= self._newest_ns - self._woken_ns < _TOGETHER_NS:
            self._woken_ns = self._newest_ns
            self._something.set()

    def show_path(self, points_m: Array) -> None:
        """Draw the path that the robot is going to follow.

        Args:
            points_m: (n, 2) positions in the wall frame.
        """
        if self._closed:
            return
        self._waiting.append(points_m)
        self._something.set()

    def _room_comes(self) -> bool:
        """Wait until the queue has room; False if the viewer accepts no more."""
        while self._thread.is_alive():
            self._room.clear()
            self._something.set()
            if len(self._waiting) < self._capacity:
                return True
            if not self._room.wait(self._patience_s):
                self._give_up(f"the viewer took nothing for {self._patience_s:g} s")
        return False

    def _give_up(self, why: str) -> None:
        """Kill the process, which also ends the wait of the thread."""
        self._process.kill()
        self._thread.join(self._patience_s)
        self.failure = why

    def _drop_oldest(self) -> None:
        try:
            self._waiting.popleft()
        except IndexError:
            return
        self.dropped += 1

    def _feed(self) -> None:
        """Thread: write the queue into the pipe, several records at once."""
        try:
            while True:
                self._something.wait(_LEFT_S)
                self._something.clear()
                nothing_comes = self._closed
                while self._take():
                    self._send(packed(self._in_hand))
                    self._in_hand = []
                    self._room.set()
                if nothing_comes:
                    self._send(b"")
                    return
        except (OSError, ValueError) as error:
            self.failure = f"the monitor process has ended ({error})"
            self._room.set()

    def _take(self) -> bool:
        """Move the oldest records of the queue into the next batch; False if the batch is empty."""
        while self._waiting and len(self._in_hand) < _MOST_TOGETHER:
            with contextlib.suppress(IndexError):  # another thread has dropped it as the oldest
                self._in_hand.append(self._waiting.popleft())
        return bool(self._in_hand)

    def _send(self, payload: bytes) -> None:
        put(self._pipe, payload, self.dropped)

    def close(self) -> None:
        """Show the rest of the queue and end the process. Idempotent; never raises."""
        if self._closed:
            return
        self._closed = True
        self._close_process()
        lacking = [
            f"{name} is incomplete: {why}" for name in self._files if (why := what_is_missing(Path(name)))
        ]
        self.failure = "; ".join([self.failure] * bool(self.failure) + lacking)
        if self.dropped or self.failure:
            unshown = [f"{self.dropped} cycles not shown"] * bool(self.dropped)
            LOG.warning("monitor: %s", ". ".join([*unshown, *([self.failure] * bool(self.failure))]))

    def _close_process(self) -> None:
        self._something.set()
        self._thread.join(self._patience_s)
        if self._thread.is_alive():
            self._give_up(f"the viewer did not take the rest within {self._patience_s:g} s")
        try:
            ended_well = self._process.wait(self._patience_s) == 0
            if not (ended_well or self.failure) and self._viewers:
                self.failure = f"the viewer at {', '.join(self._viewers)} did not take everything"
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            self.failure = "the viewer did not finish"
        self.dropped += sum(isinstance(shown, CycleRecord) for shown in (*self._in_hand, *self._waiting))
        with contextlib.suppress(OSError):  # the rest in the pipe's buffer has no reader
            self._pipe.close()
