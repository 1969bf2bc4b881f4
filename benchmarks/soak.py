"""Hours of driving on the wall with random faults: does anything leak, drift, or stay unexplained?

    python benchmarks/soak.py --minutes 20
    python benchmarks/soak.py --minutes 120 --stretch 30 --seed 3
    python benchmarks/soak.py --minutes 15 --stretch 5 --real

One bench after another drives up and down in virtual time, each for a stretch, recorded. Every few
seconds some device fails for a moment; what would truly let the robot go, and what changes a device for
ever, is left out. After every stop the robot must be held again, and the stop must name one that has
failed. A line of the table is one stretch: cycles, faults, stops, memory that this process uses when it
ended (MB; what is free goes back to the system first), open files and threads, processor time for a second
of virtual time, cycles that were left out because the one before took longer, cycles that began beside
the grid, and seconds of processor time that other machines on the same computer took away from this one (on
Linux). Exit code 1 for an unexplained stop, a robot that is not held, a cycle left out while
nothing fails, one beside the grid, a file or thread too many, or memory that grows by more than `--leak` MB
an hour, by the median slope between any two stretches of the second half: a module that is loaded for the
first time is a step, not a leak. With `--real` the same in real time, against
emulated devices in a process of their own; cycles that are left out are counted only, because other
programs delay them too. An unexplained stop counts in any case: look at the stolen time first.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import os
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from host import stolen_s

from hil.bench import open_bench
from hil.core.clock import NS_PER_S
from hil.core.errors import HilError
from hil.core.registry import kinds
from hil.faults.fault import parse_fault
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import line

_LIBC = ctypes.CDLL(None)
WAY_M, MINUTE_S = 0.12, 60.0
LEAST_MINUTES = 5.0
"""Of the second half: with fewer its slope says nothing."""
LASTING = ("jump", "unplug")
"""Faults that leave a device another one than before, or one that has to be opened again."""
LETS_GO = ("plant", "adhesion", "thrust", "load_cells")
"""Devices whose faults may truly let the robot go, or leave no sensor that shows how it is held."""
_REFUSALS = 3
"""So many drives in a row that end before their first cycle are no device that fails just then."""
_OPENS_S = 3.0
"""What a bench takes to open at the most, so long as nothing has to be waited for."""
EVERY_S, LONGEST_S, BACK_S = (2.0, 6.0), 1.5, 3.5


@dataclass
class Stretch:
    """What was seen of one.

    Attributes:
        faults, stops, cycles, left_out, off_grid: counts.
        wrong: what must not be.
        reasons: of the stops.
    """

    faults: int = 0
    stops: int = 0
    cycles: int = 0
    left_out: int = 0
    off_grid: int = 0
    wrong: list[str] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)


class Trouble:
    """Lets devices of a bench fail, one at a time."""

    def __init__(self, bench: Any, rng: np.random.Generator) -> None:
        self._bench, self._rng = bench, rng
        self._pairs = possible(bench)
        self.recent: list[tuple[float, str]] = []
        self.count = 0
        self._due_s = self._now_s() + 3.0

    def _now_s(self) -> float:
        return float(self._bench.clock.now_ns() / NS_PER_S)

    def stir(self) -> None:
        """Let the next device fail when its time has come."""
        now_s = self._now_s()
        if now_s < self._due_s:
            return
        device, kind = self._pairs[int(self._rng.integers(len(self._pairs)))]
        lasts_s = self._rng.uniform(0.05, LONGEST_S)
        self._bench.world.faults.clear()
        self._bench.world.faults.add(parse_fault(f"{device}:{kind}@{now_s:.3f}+{lasts_s:.3f}"))
        self._due_s = now_s + lasts_s + self._rng.uniform(*EVERY_S)
        self.recent = [*self.recent, (now_s, device)][-3:]
        self.count += 1

    def is_near(self) -> bool:
        """Whether a device fails, or has just come back."""
        return bool(self.recent) and self._now_s() < self.recent[-1][0] + LONGEST_S + BACK_S

    def explains(self, message: str) -> bool:
        """Whether a message names a device that has failed lately, or whose motion was wrong."""
        words = {w for _, device in self.recent for w in _words(device)}
        return any(word in message.lower() for word in words)


class Timetable(Trouble):
    """Faults that are known before the bench opens: the emulated devices are in another process.

    Args:
        seed: of the faults.
        minutes: how long there are any.
    """

    def __init__(self, seed: int, minutes: float) -> None:
        self._rng = np.random.default_rng(seed)
        with open_bench("emulated", seed=seed) as bench:
            pairs = possible(bench)
        self.specs, self._plan, at_s = [], [], 5.0
        while at_s < minutes * MINUTE_S:
            device, kind = pairs[int(self._rng.integers(len(pairs)))]
            lasts_s = self._rng.uniform(0.05, LONGEST_S)
            self.specs.append(f"{device}:{kind}@{at_s:.3f}+{lasts_s:.3f}")
            self._plan.append((at_s, device))
            at_s += lasts_s + self._rng.uniform(*EVERY_S)

    def begin(self, bench: Any) -> None:
        """The bench is open; its devices began to live a little earlier."""
        self._bench, self._began_s = bench, 0.0
        self._began_s = self._now_s() - _OPENS_S

    def stir(self) -> None:
        """What has failed by now."""
        gone_s = self._now_s() - self._began_s
        past = [(at_s + self._began_s, device) for at_s, device in self._plan if at_s < gone_s]
        self.count, self.recent = len(past), past[-3:]

    def explains(self, message: str) -> bool:
        """As for faults that were just made."""
        self.stir()
        return super().explains(message)


def possible(bench: Any) -> list[tuple[str, str]]:
    """Devices and faults that let no robot go."""
    return [
        (device, kind)
        for device, faults in bench.world.faults.supported.items()
        if device not in LETS_GO
        for kind in faults
        if kind not in LASTING
    ]


def _words(device: str) -> set[str]:
    """By what messages may call a device."""
    head = device.split(".", 1)[0].rstrip("s")
    kind = next(
        k for k in kinds().values() if head in (k.name.rstrip("s"), k.shown_as.rstrip("s"), *k.aliases)
    )
    moved = {"wheels"} if kind.moves_robot else set()
    return {kind.name, kind.noun.lower().rstrip("s"), head, *moved}


def stretch(seed: int, minutes: float, folder: Path) -> Stretch:
    """One bench, driven up and down for a while."""
    with open_bench("emulated", seed=seed) as bench:
        return drive(bench, Trouble(bench, np.random.default_rng(seed)), minutes, folder)


def real_stretch(seed: int, minutes: float, folder: Path) -> Stretch:
    """The same in real time."""
    trouble = Timetable(seed, minutes)
    with open_bench("emulated", seed=seed, realtime=True, faults=trouble.specs) as bench:
        trouble.begin(bench)
        return drive(bench, trouble, minutes, folder, real=True)


def drive(bench: Any, trouble: Trouble, minutes: float, folder: Path, *, real: bool = False) -> Stretch:
    """Up and down until the time is over."""
    seen = Stretch()
    bench.add_sink(McapRecorder(str(folder / "soak.mcap"), bench.header(), lossless=not real))
    home = here = np.array(bench.config.environment.start_pose, dtype=np.float64)
    period_ns = round(NS_PER_S / bench.config.loop.rate_hz)
    end_ns, up, last_ns = bench.clock.now_ns() + round(minutes * MINUTE_S * NS_PER_S), True, 0
    refused = 0

    def look(record: Any) -> None:
        nonlocal last_ns, here
        trouble.stir()
        seen.cycles += 1
        gone_ns = record.deadline_ns - last_ns if last_ns else period_ns
        periods, beside = divmod(gone_ns, period_ns)
        last_ns = record.deadline_ns
        seen.off_grid += beside != 0
        seen.left_out += periods - 1
        if periods > 1 and not (real or trouble.is_near()):
            seen.wrong.append(f"{periods - 1} cycles left out while nothing fails")
        if np.isfinite(record.state.pose_body_in_wall).all():
            here = record.state.pose_body_in_wall

    while bench.clock.now_ns() < end_ns:
        here = here if real else bench.truth().pose_body_in_wall.copy()
        there = home + np.array([WAY_M if up else 0.0, 0.0, 0.0])
        up, last_ns, before = not up, 0, seen.cycles
        try:
            bench.drive(line(here, there), start_pose=here, hold_s=0.2, on_cycle=look)
        except HilError as stop:
            _stopped(bench, seen, trouble, stop)
            refused = refused + 1 if seen.cycles == before else 0
            if refused == _REFUSALS:
                seen.wrong.append(f"does not go on after {trouble.recent}: {stop}")
                break
    seen.faults = trouble.count
    return seen


def _stopped(bench: Any, seen: Stretch, trouble: Trouble, stop: HilError) -> None:
    """A stop has to be explained by what failed, and the robot to be held soon after that is over."""
    seen.stops += 1
    seen.reasons[getattr(stop, "reason", type(stop).__name__)] += 1
    if not trouble.explains(str(stop)):
        seen.wrong.append(f"unexplained after {trouble.recent}: {stop}")
    bench.clock.sleep_until_ns(bench.clock.now_ns() + round(LONGEST_S * NS_PER_S))
    held = bench.look(BACK_S)
    if held.state != "HELD":  # in real time the next device has failed meanwhile
        held = bench.look(BACK_S)
    if held.state != "HELD":
        seen.wrong.append(f"after {trouble.recent}: {held.state}: {held.why}")


def memory_mb() -> float:
    """Of this process, resident, once what is free has gone back to the system."""
    gc.collect()
    if hasattr(_LIBC, "malloc_trim"):
        _LIBC.malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Drive, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="virtual time in all")
    parser.add_argument("--stretch", type=float, default=2.0, help="minutes of one bench")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real", action="store_true", help="in real time")
    parser.add_argument("--leak", type=float, default=20.0, help="MB per hour")
    options = parser.parse_args()
    wrong, memory, handles, reasons = [], [], [], Counter()
    print("stretch  cycles  faults  stops      MB  files  threads  cpu s/s  left out  off grid  stolen s")
    for k in range(max(1, round(options.minutes / options.stretch))):
        began_s, others_s = time.process_time(), stolen_s()
        with tempfile.TemporaryDirectory(prefix="hil-soak-") as folder:
            kind = real_stretch if options.real else stretch
            seen = kind(options.seed + k, options.stretch, Path(folder))
        cpu_s = (time.process_time() - began_s) / (options.stretch * MINUTE_S)
        memory.append(memory_mb())
        handles.append((len(os.listdir("/proc/self/fd")), threading.active_count()))
        reasons += seen.reasons
        wrong += [f"stretch {k}: {text}" for text in seen.wrong]
        wrong += [f"stretch {k}: {seen.off_grid} cycles off the grid"] if seen.off_grid else []
        print(
            f"{k:7d} {seen.cycles:7d} {seen.faults:7d} {seen.stops:6d} {memory[-1]:7.1f} {handles[-1][0]:6d} "
            f"{handles[-1][1]:8d} {cpu_s:8.3f} {seen.left_out:9d} {seen.off_grid:9d} "
            f"{stolen_s() - others_s:9.1f}",
            flush=True,
        )
    later = memory[len(memory) // 2 :]
    if len(later) > 1 and len(later) * options.stretch >= LEAST_MINUTES:
        pairs = combinations(enumerate(later), 2)
        per_stretch = float(np.median([(b - a) / (j - i) for (i, a), (j, b) in pairs]))
        slope = per_stretch * MINUTE_S / options.stretch
        print(f"memory grows by {slope:.1f} MB per hour")
        wrong += [f"memory grows by {slope:.1f} MB an hour"] if slope > options.leak else []
    if any(a > b for a, b in zip(handles[-1], handles[0], strict=True)):
        wrong.append(f"files and threads were {handles[0]} and are {handles[-1]}")
    print("stops:", ", ".join(f"{reason} {count}" for reason, count in reasons.most_common()) or "none")
    for text in wrong:
        print(f"WRONG {text}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
