"""A controller on ROS 2 beside the bench: round trip and share answered in real time, cycles in lockstep.

    python benchmarks/ros2_round_trip.py                        # 20 s at 100 and at 500 Hz, then lockstep
    python benchmarks/ros2_round_trip.py --seconds 60 --program build/wall_line_dds

The controller is `examples/ros2/fast_dds`, in a process of its own; without --program it is built first.

In real time a loop shows recorded cycles of the emulated bench, all topics of each, and waits for the answer
for `ros2.wait_share` of the cycle, as the bench's own loop does. `round_trip_ms` is from the beginning of the
cycle's first message to the command, encoding included, of cycles that were answered in time. An idle loop of
the same rate runs before it: `late_percent` is of cycles that began more than 1 ms late, `core_percent` the
processor time of this process.

In lockstep the robot drives a line in virtual time, by its own law and by the controller in turns, medians of
--runs. `ratio` is by wall-clock time; `processor_ratio` by the processor time of a cycle, that of bench and
controller together, which other work on the computer does not change as much.

A figure says something only of a computer that does nothing else: `load_before`, `stolen_ms`.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from host import stolen_s

from hil.core.clock import NS_PER_S, MonotonicClock, WallOffset
from hil.core.interfaces import CommandingSink
from hil.core.signals import CycleRecord
from hil.procedure.bench_source import BenchSource
from hil.recording.transform_tree import describe_clock
from hil.robot.trajectories import line
from hil.ros2.network import Network
from hil.ros2.publisher import Ros2Publisher

TOPIC = "/joint_commands"
SOURCE = Path(__file__).resolve().parents[1] / "examples" / "ros2" / "fast_dds"
BENCH = "emulated_floor"
RATES_HZ = (100, 500)
_LATE_NS = 1_000_000
_PATIENCE_S = 30.0
_LINE_M, _LINE_S = 0.1, 5.0


def built(folder: str) -> Path:
    """The controller, built as its page says."""
    for words in (["cmake", "-S", str(SOURCE), "-B", folder], ["cmake", "--build", folder]):
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return Path(folder) / "wall_line_dds"


@contextmanager
def controller(program: Path, domain: int) -> Iterator[int]:
    """The controller in a process of its own; gives its ID."""
    words = [str(program), "--domain", str(domain), "--topic", TOPIC, "--up", str(_LINE_M)]
    begun = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    try:
        yield begun.pid
    finally:
        begun.kill()
        begun.wait()


def recorded() -> tuple[dict[str, Any], list[CycleRecord]]:
    """Header of an emulated bench, and the cycles of a second at rest."""
    with BenchSource(BENCH).open() as bench:
        records: list[CycleRecord] = []
        bench.observe(1.0, on_cycle=records.append)
        return dict(bench.header()), records


def paced(rate_hz: int, seconds: float, work: Any) -> dict[str, float]:
    """Late cycles and processor time of a loop that does some work in each cycle."""
    clock, period_ns = MonotonicClock(), round(NS_PER_S / rate_hz)
    cycles, late = round(seconds * rate_hz), 0
    deadline_ns, cpu_s = clock.now_ns(), time.process_time()
    begun_ns = deadline_ns
    for k in range(cycles):
        clock.sleep_until_ns(deadline_ns)
        now_ns = clock.now_ns()
        late += now_ns - deadline_ns > _LATE_NS
        work(k, now_ns)
        deadline_ns = max(deadline_ns + period_ns, clock.now_ns())
    took_s = (clock.now_ns() - begun_ns) / NS_PER_S
    return {
        "late_percent": 100.0 * late / cycles,
        "core_percent": 100.0 * (time.process_time() - cpu_s) / took_s,
    }


def in_real_time(
    rate_hz: int,
    seconds: float,
    domain: int,
    program: Path,
    header: dict[str, Any],
    cycles: Sequence[CycleRecord],
) -> dict[str, Any]:
    """Round trips of a loop of a rate."""
    loop = {**header["config"]["loop"], "rate_hz": float(rate_hz)}
    offset = WallOffset(time.time_ns() - time.monotonic_ns(), 0, time.monotonic_ns())
    header = {**header, "config": {**header["config"], "loop": loop}, "clock": describe_clock(offset)}
    idle = paced(rate_hz, seconds, lambda k, now_ns: None)
    publisher = Ros2Publisher(Network(domain), TOPIC, patient=True)
    sink = publisher.sink(header)
    assert isinstance(sink, CommandingSink)
    trips_ns: list[int] = []

    def ask(k: int, now_ns: int) -> None:
        seen = cycles[k % len(cycles)]
        heard = sink.ask(replace(seen, inputs=replace(seen.inputs, t_ns=now_ns)))
        assert not heard.reason, heard.trouble
        if heard.commands:
            trips_ns.append(time.monotonic_ns() - now_ns)

    try:
        with controller(program, domain):
            until_s = time.monotonic() + _PATIENCE_S
            while not trips_ns and time.monotonic() < until_s:
                paced(rate_hz, 0.1, ask)
            assert trips_ns, "the controller was not found"
            assert publisher.exchange is not None
            trips_ns.clear()
            shown, answered = publisher.exchange.cycles, publisher.exchange.answered
            busy = paced(rate_hz, seconds, ask)
            shown, answered = publisher.exchange.cycles - shown, publisher.exchange.answered - answered
    finally:
        publisher.close()
    trips_ms = np.array(trips_ns) / 1e6
    return {
        "cycles": shown,
        "answered_in_time_percent": 100.0 * answered / shown,
        "round_trip_ms": dict(
            zip(("median", "p99"), np.percentile(trips_ms, (50, 99)).tolist(), strict=True)
        ),
        "with": busy,
        "idle_loop": idle,
    }


def processor_s(pid: int) -> float:
    """Processor time of a process so far."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) / NS_PER_S


class Watch:
    """Cycles of a drive against wall clock and processor, its first tenth left out.

    Args:
        cycles: roughly, of the drive.
        pid: of the controller; None for the bench's own law.
    """

    def __init__(self, cycles: int, pid: int | None) -> None:
        self._skip, self._pid, self._cycle = cycles // 10, pid, 0
        self._first: tuple[float, float, float] | None = None

    def __call__(self, _: CycleRecord) -> None:
        """One cycle more."""
        self._cycle += 1
        if self._cycle == self._skip:
            self._first = self._now()

    def figures(self) -> tuple[float, float, float]:
        """Wall-clock time, and processor time of bench and controller, of a cycle, in ms."""
        assert self._first is not None
        since = zip(self._first, self._now(), strict=True)
        wall_ms, bench_ms, controller_ms = (1e3 * (b - a) / (self._cycle - self._skip) for a, b in since)
        return wall_ms, bench_ms, controller_ms

    def _now(self) -> tuple[float, float, float]:
        return time.monotonic(), time.process_time(), 0.0 if self._pid is None else processor_s(self._pid)


def driven(domain: int, program: Path | None) -> tuple[float, float, float]:
    """`Watch.figures` of a line in virtual time: by the bench's own law, or by the controller."""
    if program is None:
        return _drive(BenchSource(BENCH), None)
    publisher = Ros2Publisher(Network(domain), TOPIC)
    waits = {"ros2.answer_timeout_s": 10.0, "ros2.start_timeout_s": _PATIENCE_S}
    source = BenchSource(BENCH, controller=f"ros2:{TOPIC}", publish=publisher.sink, overrides=waits)
    try:
        with controller(program, domain) as pid:
            return _drive(source, pid)
    finally:
        publisher.close()


def _drive(source: BenchSource, pid: int | None) -> tuple[float, float, float]:
    watch = Watch(round(_LINE_S * RATES_HZ[0]), pid)
    with source.open() as bench:
        pose = bench.settle()
        way = line(pose, pose + np.array([_LINE_M, 0, 0]), duration_s=_LINE_S)
        bench.drive(way, start_pose=pose, hold_s=0.5, on_cycle=watch)
        return watch.figures()


def in_lockstep(domain: int, program: Path, runs: int) -> dict[str, float]:
    """What a cycle takes with and without the controller, driven in turns; medians."""
    own, external = [], []
    for _ in range(runs):
        own.append(driven(domain, None))
        external.append(driven(domain, program))
    (own_ms, own_cpu_ms, _), (with_ms, bench_cpu_ms, controller_cpu_ms) = (
        (statistics.median(column) for column in zip(*found, strict=True)) for found in (own, external)
    )
    return {
        "own_law_hz": 1e3 / own_ms,
        "controller_hz": 1e3 / with_ms,
        "ratio": own_ms / with_ms,
        "own_law_processor_ms": own_cpu_ms,
        "bench_processor_ms": bench_cpu_ms,
        "controller_processor_ms": controller_cpu_ms,
        "processor_ratio": own_cpu_ms / (bench_cpu_ms + controller_cpu_ms),
    }


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--runs", type=int, default=3, help="drives in lockstep")
    parser.add_argument("--domain", type=int, default=97)
    parser.add_argument("--program", type=Path, help="wall_line_dds, built")
    arguments = parser.parse_args()
    load, stolen = os.getloadavg()[0], stolen_s()
    with tempfile.TemporaryDirectory() as folder:
        program = arguments.program or built(folder)
        header, cycles = recorded()
        figures: dict[str, Any] = {"load_before": load, "processors": os.cpu_count()}
        for rate_hz in RATES_HZ:
            figures[f"{rate_hz}_hz"] = in_real_time(
                rate_hz, arguments.seconds, arguments.domain, program, header, cycles
            )
        figures["lockstep"] = in_lockstep(arguments.domain, program, arguments.runs)
    figures["stolen_ms"] = 1e3 * (stolen_s() - stolen)
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
