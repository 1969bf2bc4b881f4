"""What recording and monitoring cost a loop: time of `write`, late cycles beside an idle loop, file size.

    python benchmarks/recording.py --seconds 60 --rate 100

Every value of every record is noise, which no compression can shrink: sizes are upper bounds.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hil.core.clock import NS_PER_S, MonotonicClock
from hil.core.interfaces import Sink
from hil.core.signals import (
    CycleRecord,
    EncoderSample,
    GyroMeasurement,
    ImuSample,
    Inputs,
    Measurements,
    MocapSample,
    PoseMeasurement,
    Reference,
    RobotState,
    ServoSample,
    ServoSetpoint,
    Stamp,
    Status,
    TrackerSample,
    WheelMeasurement,
    WheelSetpoint,
)
from hil.recording.mcap_reader import read_cycles
from hil.recording.mcap_writer import McapRecorder

_LATE_NS = 1_000_000


def noisy_record(k: int, t_ns: int, rng: np.random.Generator) -> CycleRecord:
    """One cycle with all five devices, the camera twice, and twenty diagnostics."""
    n = rng.normal
    stamp = Stamp(t_ns, t_ns + 1000, k)
    inputs = Inputs(
        k,
        t_ns,
        servos=(ServoSample(stamp, n(size=8), n(size=8), n(size=8), (Status.OK,) * 8),),
        encoders=(EncoderSample(stamp, n(size=4), (Status.OK,) * 4, (1, 2, 3, 4)),),
        imu=(ImuSample(stamp, n(size=4), n(size=3), n(size=3), n(size=3), (3, 3, 3, 3)),),
        tracker=tuple(TrackerSample(stamp, n(size=3), n(size=4), n(size=3), n(size=3), 3) for _ in range(2)),
        mocap=(MocapSample(stamp, n(size=3), n(size=4), True, 0.004, 1e-4),),
    )
    measurements = Measurements(
        k,
        t_ns,
        (WheelMeasurement(stamp, n(size=4), n(size=4), n(size=4), (True,) * 4),),
        (GyroMeasurement(stamp, float(n()), float(n()), n(size=2)),),
        tuple(PoseMeasurement(stamp, "tracker", n(size=3), 3, True) for _ in range(2)),
        (PoseMeasurement(stamp, "mocap", n(size=3), 3, True),),
    )
    root = n(size=(6, 6))
    diagnostics = {f"nis_{i}": float(n()) for i in range(20)}
    return CycleRecord(
        k,
        t_ns,
        t_ns,
        inputs,
        measurements,
        RobotState(t_ns, n(size=3), n(size=3), root @ root.T, diagnostics),
        Reference(t_ns / NS_PER_S, n(size=3), n(size=3), n(size=3)),
        WheelSetpoint(n(size=4), n(size=4)),
        ServoSetpoint(n(size=4), n(size=4)),
        timing_ns={"read": 1, "decide": 2, "write": 3, "lateness": 4},
    )


def run(
    sinks: tuple[Sink, ...], seconds: float, rate_hz: float, records: list[CycleRecord]
) -> dict[str, float]:
    """Late cycles and the time that the sinks take from a loop at a fixed rate."""
    clock, period_ns = MonotonicClock(), round(NS_PER_S / rate_hz)
    start_ns, late, cost_ns = clock.now_ns() + period_ns, 0, []
    cycles = round(seconds * rate_hz)
    for k in range(cycles):
        deadline_ns = start_ns + k * period_ns
        clock.sleep_until_ns(deadline_ns)
        before_ns = clock.now_ns()
        late += before_ns - deadline_ns > _LATE_NS
        for sink in sinks:
            sink.write(records[k % len(records)])
        cost_ns.append(clock.now_ns() - before_ns)
    cost_us = np.array(cost_ns) / 1e3
    return {
        "cycles": cycles,
        "late_percent": 100.0 * late / cycles,
        "sinks_mean_us": float(cost_us.mean()),
        "sinks_p99_us": float(np.percentile(cost_us, 99)),
        "sinks_worst_us": float(cost_us.max()),
    }


def timed(clock: MonotonicClock, work: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    before_ns = clock.now_ns()
    work()
    return (clock.now_ns() - before_ns) / NS_PER_S


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--rerun", action="store_true", help="also with the monitor writing a .rrd file")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    count = round(min(options.seconds, 20.0) * options.rate)
    period_ns = round(NS_PER_S / options.rate)
    records = [noisy_record(k, k * period_ns, rng) for k in range(count)]
    out: dict[str, object] = {"rate_hz": options.rate}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        out["idle"] = run((), options.seconds, options.rate, records)
        recorder = McapRecorder(path, {}, lossless=False)
        sinks: tuple[Sink, ...] = (recorder,)
        if options.rerun:
            from hil.monitor import RerunMonitor

            sinks += (RerunMonitor(str(Path(folder) / "run.rrd"), lossless=False),)
        out["recording"] = run(sinks, options.seconds, options.rate, records)
        for sink in sinks:
            sink.close()
        out["recorder"] = recorder.report() | {"path": path.name}
        out["bytes_per_cycle"] = path.stat().st_size / max(1, recorder.written)
        out["mb_per_10_min"] = path.stat().st_size / max(1, recorder.written) * options.rate * 600 / 1e6
        read_s = timed(MonotonicClock(), lambda: sum(1 for _ in read_cycles(path)))
        out["read_times_real_time"] = recorder.written / options.rate / read_s
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()
