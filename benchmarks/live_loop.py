"""The live loop against an idle loop of the same rate: late cycles, work, lost samples, memory, recording.

    python benchmarks/live_loop.py                                  # 20 s of 100 Hz
    python benchmarks/live_loop.py --seconds 600                    # ten minutes
    python benchmarks/live_loop.py --seconds 60 --rate 200 --baud 4000000
    python benchmarks/live_loop.py --rate 400 --unpaced             # the quickest bus that is emulated
    python benchmarks/live_loop.py --viewer stopped                 # also killed, absent, running

The servos are asked ahead, as by every bench in real time (`servos.prefetch`); --no-prefetch shows what a
loop costs that waits for them.

An idle loop, which sleeps until each deadline and does nothing, runs first. Then the emulated bench in
a process of its own, with the EKF in the loop, the robot driving, recording and the Rerun view on (a
file, and with --viewer a Rerun server that is stopped or killed after a quarter of the time, or was
never there). Late is a cycle that starts more than 1 ms after its deadline. The devices' own losses
are switched off, so that every sample that is missing or bad has been lost on the way. `processor` is the
processor time of the reading process, user and system, in % of a core, in total and by thread. `checks` holds
the figures against what is asked of the loop. A figure says something only of a machine that does
nothing else (`load_before`); on a virtual one `stolen_ms` is what its host took of both phases.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from host import stolen_s

from hil.bench import open_bench
from hil.config.servo_models.x_series_codes import BAUD_CODES
from hil.core.clock import NS_PER_S, MonotonicClock, nanoseconds
from hil.core.geometry import Array
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord
from hil.live import LivePlan, LiveSession
from hil.loop.realtime import RealTime, idle_loop
from hil.monitor import RerunMonitor, Scene
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import Trajectory, through

VIEWERS = ("none", "running", "stopped", "killed", "absent")
PERFECT = {
    "emulation.tracker.drop_probability": 0.0,
    "emulation.mocap.gaps_per_s": 0.0,
    "emulation.mocap.stalls_per_s": 0.0,
}
_SIDE_M = 0.2
_USUAL_HZ = 100.0
_MORE_LATE_PERCENT, _FAST_MORE_LATE_PERCENT = 0.05, 0.3
_WORK_P99_MS, _CORE_PERCENT = 2.5, 15.0
_GROWTH_MB, _RECORDING_US, _MB_PER_10_MIN = 5.0, 500.0, 150.0
_FASTEST_BAUD = max(BAUD_CODES)
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


class Memory(Sink):
    """Resident memory of this process over the loop's time, once per second."""

    def __init__(self) -> None:
        self._start_ns = self._next_ns = 0
        self.samples: list[tuple[float, float]] = []

    def write(self, record: CycleRecord) -> None:
        """Look once per second."""
        if record.start_ns < self._next_ns:
            return
        self._start_ns = self._start_ns or record.start_ns
        self._next_ns = record.start_ns + NS_PER_S
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.samples.append(((record.start_ns - self._start_ns) / NS_PER_S, pages * _PAGE_BYTES / 1e6))

    def close(self) -> None:
        """Nothing to let go of."""

    def growth_mb(self, after_s: float) -> float:
        """From the given time to the end."""
        later = [mb for t_s, mb in self.samples if t_s >= after_s]
        return later[-1] - later[0] if later else 0.0


class Processor(Sink):
    """Processor time of this process over the loop's time, by thread: user and system, once per second."""

    def __init__(self) -> None:
        self._next_ns = 0
        self._looks: list[tuple[int, int, dict[str, float]]] = []

    def write(self, record: CycleRecord) -> None:
        """Look once per second."""
        if record.start_ns < self._next_ns:
            return
        self._next_ns = record.start_ns + NS_PER_S
        self._looks.append((record.start_ns, record.cycle, self._taken_s()))

    def close(self) -> None:
        """Nothing to let go of."""

    @staticmethod
    def _taken_s() -> dict[str, float]:
        """Processor time so far by name of the thread; `all` has also those that are not Python's."""
        taken = {"all": time.process_time()}
        for thread in threading.enumerate():
            if thread.ident is not None:
                clock = time.pthread_getcpuclockid(thread.ident)
                taken[thread.name] = taken.get(thread.name, 0.0) + time.clock_gettime(clock)
        return taken

    def report(self) -> dict[str, Any]:
        """Shares of a core in %, and ms a cycle, of all and of every thread that takes something."""
        (begin_ns, first, before), *_, (end_ns, last, after) = self._looks
        per_s = NS_PER_S / (end_ns - begin_ns)
        took_s = {name: after[name] - before.get(name, 0.0) for name in after}
        shares = {name: 100.0 * per_s * took for name, took in took_s.items()}
        return {
            "core_percent": shares.pop("all"),
            "ms_a_cycle": 1e3 * took_s["all"] / (last - first),
            "threads_percent": dict(sorted(shares.items(), key=lambda item: -item[1])),
        }


class Timed(Sink):
    """How long another sink's `write` takes from the loop, us."""

    def __init__(self, sink: Sink) -> None:
        self._sink, self._clock = sink, MonotonicClock()
        self.took_us: list[float] = []

    def write(self, record: CycleRecord) -> None:
        """Pass on and measure."""
        before_ns = self._clock.now_ns()
        self._sink.write(record)
        self.took_us.append((self._clock.now_ns() - before_ns) / 1e3)

    def rest(self) -> None:
        """Pass on."""
        self._sink.rest()

    def close(self) -> None:
        """Pass on."""
        self._sink.close()


class At(Sink):
    """Does something once, a given time after the first cycle."""

    def __init__(self, after_s: float, action: Callable[[], object]) -> None:
        self._after_ns, self._action = nanoseconds(after_s), action
        self._due_ns: int | None = None
        self._done = False

    def write(self, record: CycleRecord) -> None:
        """Look whether it is time."""
        if self._due_ns is None:
            self._due_ns = record.start_ns + self._after_ns
        if record.start_ns >= self._due_ns and not self._done:
            self._done = True
            self._action()

    def close(self) -> None:
        """Nothing to let go of."""


def idle(seconds: float, rate_hz: float, fifo_priority: int | None) -> dict[str, float]:
    """A loop that does nothing."""
    clock = MonotonicClock()
    real_time = RealTime(clock, fifo_priority=fifo_priority)
    return _punctuality(idle_loop(clock, real_time, seconds=seconds, rate_hz=rate_hz).summary())


def _punctuality(summary: dict[str, float]) -> dict[str, float]:
    late = 100.0 * summary["late"] / max(1.0, summary["cycles"])
    return {"late_percent": late, **summary}


def rounds(seconds: float) -> Callable[[Array], Trajectory]:
    """Up, left, down and right again, for at least the given time."""

    def make(pose: Array) -> Trajectory:
        corners = [
            pose + np.array(d) for d in ((_SIDE_M, 0, 0), (_SIDE_M, _SIDE_M, 0), (0, _SIDE_M, 0), (0, 0, 0))
        ]
        one = through([pose, *corners])
        laps = int(seconds / one.duration_s) + 1
        return through([pose, *(corners * laps)])

    return make


def start_viewer(stack: ExitStack, kind: str) -> tuple[str, int | None]:
    """URL of a Rerun server, and its process group; no server listens there when it is to be absent."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    if kind == "absent":
        return url, None
    viewer = Path(sys.executable).parent / "rerun"
    server = subprocess.Popen(
        [str(viewer), "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )

    def end() -> None:
        for number in (signal.SIGCONT, signal.SIGKILL):
            subprocess.run(
                ["kill", f"-{number.value}", "--", f"-{server.pid}"], check=False, capture_output=True
            )
        server.wait()

    stack.callback(end)
    return url, server.pid


def live(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """The whole loop."""
    overrides: dict[str, object] = {**PERFECT, "loop.rate_hz": options.rate}
    if options.fifo:
        overrides["loop.fifo_priority"] = options.fifo
    if options.prefetch is not None:
        overrides["servos.prefetch"] = options.prefetch
    if options.unpaced:
        overrides |= {"servos.baud": _FASTEST_BAUD, "servos.usb_latency_s": 0.0}
    elif options.baud:
        overrides |= {"servos.baud": options.baud, "servos.usb_latency_s": 0.001}
    with ExitStack() as stack:
        targets, group = [str(folder / "run.rrd")], None
        if options.viewer != "none":
            url, group = start_viewer(stack, options.viewer)
            targets.append(url)
        bench = open_bench("emulated", realtime=True, seed=options.seed, overrides=overrides)
        stack.callback(bench.close)
        recorder = McapRecorder(folder / "run.mcap", bench.header(), lossless=False)
        scene = Scene.of(bench.config, bench.geometry)
        monitor = RerunMonitor(",".join(targets), lossless=False, scene=scene)
        memory, processor, timed = Memory(), Processor(), Timed(recorder)
        for sink in (timed, monitor, memory, processor):
            bench.add_sink(sink)
        if group is not None and options.viewer in ("stopped", "killed"):
            number = signal.SIGSTOP if options.viewer == "stopped" else signal.SIGKILL
            bench.add_sink(At(options.seconds / 4.0, lambda: os.killpg(group, number)))
        plan = LivePlan(
            rounds(options.seconds), None, options.seconds, observers=("ukf",) if options.ukf else ()
        )
        session = LiveSession(bench, plan, recorder=recorder, monitor=monitor)
        with bench:
            session.run()
        summary = session.summary()
        size_mb = (folder / "run.mcap").stat().st_size / 1e6
        cycles = max(1, recorder.written)
        return {
            **_punctuality(bench.statistics.summary()),
            "prefetch": bench.config.servos is not None and bench.config.servos.prefetch,
            "processor": processor.report(),
            "samples": summary["samples"],
            "lost_samples": _lost(summary["samples"]),
            "memory_mb": memory.samples[-1][1],
            "memory_growth_mb": memory.growth_mb(min(60.0, options.seconds / 2.0)),
            "recording_us": {
                "mean": float(np.mean(timed.took_us)),
                "p99": float(np.percentile(timed.took_us, 99)),
                "worst": float(np.max(timed.took_us)),
            },
            "recording": {k: v for k, v in recorder.report().items() if k != "path"},
            "mb_per_10_min": size_mb / cycles * options.rate * 600.0,
            "monitor": {"dropped": monitor.dropped, "failure": monitor.failure},
        }


def _lost(samples: Any) -> int:
    return sum(int(s["missing"]) + sum(s["bad"].values()) for s in samples.values())


def checks(out: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What was found against what is asked of the loop; sizes and shares of a core are asked of 100 Hz."""
    live, fast = out["live"], out["rate_hz"] > _USUAL_HZ
    wanted = {
        "more_late_percent": (
            out["more_late_percent"],
            _FAST_MORE_LATE_PERCENT if fast else _MORE_LATE_PERCENT,
        ),
        "lost_samples": (live["lost_samples"], 0),
        "work_p99_ms": (live["work_p99_ms"], _WORK_P99_MS),
        "memory_growth_mb": (live["memory_growth_mb"], _GROWTH_MB),
        "recording_mean_us": (live["recording_us"]["mean"], _RECORDING_US),
    }
    if not fast:
        wanted["mb_per_10_min"] = (live["mb_per_10_min"], _MB_PER_10_MIN)
        wanted["core_percent"] = (live["processor"]["core_percent"], _CORE_PERCENT)
    return {k: {"found": v, "limit": limit, "met": v <= limit} for k, (v, limit) in wanted.items()}


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--idle-seconds", type=float, help="of the idle loop; by default as the other")
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--baud", type=int, help="baud rate of the servo bus, with a USB latency of 1 ms")
    parser.add_argument(
        "--unpaced",
        action="store_true",
        help=f"the servo bus at its highest rate ({_FASTEST_BAUD} bit/s) behind an adapter without latency",
    )
    parser.add_argument("--viewer", choices=VIEWERS, default="none")
    parser.add_argument("--fifo", type=int, help="SCHED_FIFO priority of both loops and of the emulator")
    parser.add_argument("--ukf", action="store_true", help="the UKF beside the EKF")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--prefetch",
        action=argparse.BooleanOptionalAction,
        help="servos.prefetch; by default as the bench decides",
    )
    options = parser.parse_args()
    out: dict[str, Any] = {
        "seconds": options.seconds,
        "rate_hz": options.rate,
        "viewer": options.viewer,
        "processors": os.cpu_count(),
        "load_before": os.getloadavg()[0],
    }
    with tempfile.TemporaryDirectory() as folder:
        began_s = stolen_s()
        out["idle"] = idle(options.idle_seconds or options.seconds, options.rate, options.fifo)
        between_s = stolen_s()
        out["live"] = live(options, Path(folder))
        out["stolen_ms"] = {"idle": 1e3 * (between_s - began_s), "live": 1e3 * (stolen_s() - between_s)}
    out["more_late_percent"] = out["live"]["late_percent"] - out["idle"]["late_percent"]
    out["checks"] = checks(out)
    out["load_after"] = os.getloadavg()[0]
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()
