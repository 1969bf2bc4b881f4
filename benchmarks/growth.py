"""How cost grows: with recordings, cycle rate, devices, history to be replayed, and runs of a campaign.

    python benchmarks/growth.py
    python benchmarks/growth.py --only recordings,history

Each dimension is doubled a few times. Processor time counts, the best of some turns, so that other work on
the machine matters little. `exponent` is the slope of log cost over log size: 1 is linear, 2 quadratic. Ends
with 1 where an exponent is above the 1.1 that is wanted.
"""

from __future__ import annotations

import argparse
import json
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import contextlib
import io
import runpy
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

import hil
from hil.calibration.fitting import fit
from hil.calibration.problem import make_setting
from hil.calibration.synthetic import hidden_robot, make_set
from hil.cli import main as command_line
from hil.core.clock import NS_PER_S
from hil.core.registry import kinds
from hil.core.signals import ServoSetpoint
from hil.datasets.fit_blocks import reduce_recordings
from hil.robot.kinematics import WheelGeometry

WANTED = 1.1
REST = '''"""Stand still for a second."""

from hil.procedure import Measurement, procedure


@procedure(name="rest", needs=("servos",), bench="emulated_floor", measurements=[Measurement("cycles", "1")])
def run(ctx):
    """Stand still."""
    with ctx.step("rest"):
        motion = ctx.bench.observe(1.0)
    ctx.measure("cycles", float(len(motion.records)))
'''
TURNS = 3
Sizes = Iterator[tuple[float, Callable[[], object]]]


def recordings() -> Sizes:
    """Fits to so many recordings of a robot."""
    robot, setting = hidden_robot(0), make_setting("recommended", model="dry-friction")
    for repetitions in (2, 4, 8, 16):
        blocks = reduce_recordings(make_set(robot, 0, repetitions=repetitions), setting.block_s)
        yield float(len(blocks.names)), partial(fit, blocks, setting, WheelGeometry.nominal())


def read(rate_hz: float = 100.0, seconds: float = 2.0, only: tuple[str, ...] = ()) -> None:
    """Read and command an emulated bench for a while in virtual time."""
    absent: dict[str, object] = {name: None for name in kinds() if only and name not in only}
    with hil.open_bench("emulated_floor", overrides={"loop.rate_hz": rate_hz, **absent}) as bench:
        actuators, deadline_ns = bench.devices.actuators(), bench.clock.now_ns()
        for cycle in range(round(seconds * rate_hz)):
            bench.clock.sleep_until_ns(deadline_ns)
            bench.devices.read(cycle)
            actuators.command(ServoSetpoint(np.zeros(4), np.zeros(4)))
            deadline_ns += round(NS_PER_S / rate_hz)


def rate() -> Sizes:
    """Two virtual seconds at so many cycles a second."""
    for rate_hz in (25.0, 50.0, 100.0, 200.0):
        yield rate_hz, partial(read, rate_hz)


def devices() -> Sizes:
    """Two virtual seconds of a bench with so many devices."""
    names = ("servos", "encoders", "imu", "tracker", "mocap")
    for count in range(1, len(names) + 1):
        yield float(count), partial(read, only=names[:count])


def history() -> Sizes:
    """A sample that comes so many seconds late: what has come since is replayed."""
    rewind = runpy.run_path(str(Path(__file__).with_name("estimator.py")))["rewind"]
    for history_s in (0.2, 0.4, 0.8, 1.6):
        late = rewind("ekf", history_s)
        yield history_s, partial(_repeated, late)


def _repeated(work: Callable[[], object]) -> None:
    for _ in range(20):
        work()


def runs() -> Sizes:
    """A campaign of so many runs, in one process."""
    for count in (1, 2, 4, 8):
        yield float(count), partial(_campaign, count)


def _campaign(count: int) -> None:
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as quiet:
        for stream in (contextlib.redirect_stdout, contextlib.redirect_stderr):
            quiet.enter_context(stream(printed := io.StringIO()))
        script = Path(folder, "rest.py")
        script.write_text(REST)
        asked = ["campaign", str(script), "--seeds", f"0:{count}", "--workers", "0", "--out", f"{folder}/out"]
        code = command_line(asked)
    if code:
        raise SystemExit(f"the campaign ended with {code}: {printed.getvalue()}")


DIMENSIONS: dict[str, Callable[[], Sizes]] = {
    "recordings": recordings,
    "rate": rate,
    "devices": devices,
    "history": history,
    "runs": runs,
}


def measure(sizes: Sizes) -> dict[str, object]:
    """Size and processor time (s) of each step, and the exponent."""
    found = []
    for size, work in sizes:
        work()
        took = []
        for _ in range(TURNS):
            began_s = time.process_time()
            work()
            took.append(time.process_time() - began_s)
        found.append((size, min(took)))
    logs = np.log(np.array(found))
    return {
        "sizes": [size for size, _ in found],
        "seconds": [round(took, 5) for _, took in found],
        "exponent": round(float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0]), 3),
    }


def main() -> int:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(DIMENSIONS), help="dimensions, by commas")
    out = {name: measure(DIMENSIONS[name]()) for name in parser.parse_args().only.split(",")}
    print(json.dumps({"wanted": WANTED, **out}, indent=1))
    return int(any(float(str(one["exponent"])) > WANTED for one in out.values()))


if __name__ == "__main__":
    sys.exit(main())
