"""The servo driver against the stock DYNAMIXEL SDK on the same emulated bus: rate, CPU, cost of a dead servo.

    python benchmarks/servo_bus.py --seconds 2 --rounds 5

The bus is paced at 1 Mbit/s behind an adapter with 1 ms latency, in a process of its own, on a terminal.
One cycle reads 10 bytes of each of eight servos and writes 4 bytes to each. Driver and SDK take turns, so
that other work on the machine meets both; medians count. `ours_cpu` and `sdk_cpu` are the share of one core
that the client's process takes, `ours_cpu_us_per_cycle` and `sdk_cpu_us_per_cycle` what a cycle costs.
`armed` is what a fault in front of the port costs that has not begun.
`cpu_ratio` compares the latter, because a client that polls without a pause takes less of a core that others
want too.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import statistics
import time
import timeit
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from multiprocessing.connection import Connection

import numpy as np
from dynamixel_sdk import GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from hil.config.robot import RobotConfig
from hil.config.servos import ServosConfig
from hil.core.clock import MonotonicClock
from hil.core.signals import ServoSetpoint
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.fakes.plant import make_plant
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.world import World, random_stream
from hil.faults import permission
from hil.faults.at_the_link import LinkFaults
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan
from hil.links.injection import FaultyPort, in_front_of

BAUD, LATENCY_S = 1_000_000, 0.001
IDS = tuple(range(1, 9))
READ_AT, READ_LENGTH, GOAL_AT = 126, 10, 104
DEAD_ID, DEAD_AT_S = 5, 4.0
_CYCLES, _CALLS = 200, 50_000
TARGETS = {"rate": 0.95, "cpu": 0.25, "dead_servo_ms": 3.0, "armed_cpu": 1.05}

Cycle = Callable[[], object]
Client = Callable[[str, bool], AbstractContextManager[Cycle]]


def serve(pipe: Connection, lifeline: int, faults: tuple[str, ...]) -> None:
    """Body of the emulator's process: prints its port and runs until the lifeline ends."""
    plan = FaultPlan([parse_fault(spec) for spec in faults])
    plant = make_plant(
        RobotConfig(), surface="floor", tilt_rad=0.0, rng=random_stream(1, "plant"), faults=plan
    )
    world = World(plant, seed=1, faults=plan)
    line = SerialLine(world, ServoBus(world, options=ServoBusOptions(baud=BAUD)), latency_s=LATENCY_S)
    face = SerialPty(line)
    server = EmulationServer(world, MonotonicClock(), {"servos": face}, lifeline=lifeline)
    pipe.send(face.endpoint()["port"])
    server.run()


@contextmanager
def emulator(*faults: str) -> Iterator[str]:
    """A bus in a process of its own; its port."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    reading, writing = os.pipe()

    def body() -> None:
        os.close(writing)
        serve(theirs, reading, faults)

    process = context.Process(target=body)
    process.start()
    os.close(reading)
    try:
        yield ours.recv()
    finally:
        os.close(writing)
        process.join()


@contextmanager
def our_cycle(port: str, fast: bool) -> Iterator[Cycle]:
    """Read and command of the driver."""
    config = ServosConfig(port=port, baud=BAUD, fast_sync_read=fast, fail_after_s=60.0, watchdog_s=0.0)
    driver = DynamixelServos(config, MonotonicClock())
    driver.open()
    setpoint = ServoSetpoint(np.zeros(4), np.zeros(4))

    def cycle() -> None:
        driver.read()
        driver.command(setpoint)

    try:
        yield cycle
    finally:
        driver.close()


@contextmanager
def sdk_cycle(port: str, fast: bool) -> Iterator[Cycle]:
    """The same with the stock SDK: group sync read, every value fetched, group sync write."""
    handler, packets = PortHandler(port), PacketHandler(2.0)
    handler.openPort()
    handler.setBaudRate(BAUD)
    read = GroupSyncRead(handler, packets, READ_AT, READ_LENGTH)
    write = GroupSyncWrite(handler, packets, GOAL_AT, 4)
    for servo_id in IDS:
        read.addParam(servo_id)
        write.addParam(servo_id, [0, 0, 0, 0])

    def cycle() -> None:
        (read.fastSyncRead if fast else read.txRxPacket)()
        for servo_id in IDS:
            read.getData(servo_id, READ_AT, 2)
            read.getData(servo_id, READ_AT + 2, 4)
            read.getData(servo_id, READ_AT + 6, 4)
        write.txPacket()

    try:
        yield cycle
    finally:
        handler.closePort()


def measure(cycle: Cycle, seconds: float) -> tuple[float, float]:
    """Cycles per second, and processor time per cycle in s."""
    for _ in range(5):
        cycle()
    began_s, began_cpu_s, count = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - began_s < seconds:
        cycle()
        count += 1
    return count / (time.perf_counter() - began_s), (time.process_time() - began_cpu_s) / count


def compare(seconds: float, rounds: int, fast: bool) -> dict[str, float]:
    """Rates and CPU of both, in turns on one bus."""
    found: dict[str, list[tuple[float, float]]] = {"ours": [], "sdk": []}
    with emulator() as port:
        for _ in range(rounds):
            for name, client in (("ours", our_cycle), ("sdk", sdk_cycle)):
                with client(port, fast) as cycle:
                    found[name].append(measure(cycle, seconds))
    rate = {name: statistics.median(r for r, _ in rows) for name, rows in found.items()}
    cost_s = {name: statistics.median(c for _, c in rows) for name, rows in found.items()}
    cpu = {name: statistics.median(r * c for r, c in rows) for name, rows in found.items()}
    ratios = [a[0] / b[0] for a, b in zip(found["ours"], found["sdk"], strict=True)]
    return {
        "ours_hz": round(rate["ours"], 1),
        "sdk_hz": round(rate["sdk"], 1),
        "rate_ratio": round(statistics.median(ratios), 3),
        "ours_cpu": round(cpu["ours"], 3),
        "sdk_cpu": round(cpu["sdk"], 3),
        "cpu_ratio": round(cost_s["ours"] / cost_s["sdk"], 3),
        "ours_cpu_us_per_cycle": round(1e6 * cost_s["ours"]),
        "sdk_cpu_us_per_cycle": round(1e6 * cost_s["sdk"]),
    }


class _Nothing:
    """A port that does nothing."""

    def read(self, size: int) -> bytes:
        """No bytes."""
        return b""


def _waiting_fault() -> LinkFaults:
    """A fault in front of the servos' port that does not begin."""
    plan, clock = FaultPlan([parse_fault("servos:drop@1000000")]), MonotonicClock()
    kinds, rng, began_ns = tuple(permission.BY_WIRE["bus"]), random_stream(1, "link"), clock.now_ns()
    return LinkFaults(plan, "servos", rng, kinds, clock, lambda: clock.now_ns() - began_ns, "dynamixel")


def armed(seconds: float) -> dict[str, float]:
    """Processor time of a cycle with a fault that waits, over that without.

    A computer that is not idle shows no difference of two per cent between two drivers. So the calls of one
    cycle that meet the fault are counted, and what each costs is measured alone.
    """
    link, calls = _waiting_fault(), 0
    waits = link.waiting

    def counted() -> bool:
        nonlocal calls
        calls += 1
        return waits()

    with emulator() as port:
        with our_cycle(port, True) as cycle:
            plain_s = measure(cycle, seconds)[1]
        link.waiting = counted  # type: ignore[method-assign]
        with in_front_of(link), our_cycle(port, True) as cycle:
            calls = 0
            for _ in range(_CYCLES):
                cycle()
    plain, faulty = _Nothing(), FaultyPort(_Nothing(), _waiting_fault())
    took_s = [min(timeit.repeat(partial(one.read, 4), number=_CALLS, repeat=9)) for one in (plain, faulty)]
    extra_s = calls / _CYCLES * (took_s[1] - took_s[0]) / _CALLS
    return {
        "calls_per_cycle": round(calls / _CYCLES, 1),
        "extra_us_per_cycle": round(1e6 * extra_s, 1),
        "cpu_ratio": round(1.0 + extra_s / plain_s, 3),
    }


def dead_servo(client: Client, fast: bool) -> dict[str, float]:
    """Duration of a cycle at 100 Hz before and after one servo loses its supply."""
    clock = MonotonicClock()
    with emulator(f"servo.{DEAD_ID}:off@{DEAD_AT_S}") as port, client(port, fast) as cycle:
        began_s = time.perf_counter()
        before, after = [], []
        deadline_ns = clock.now_ns()
        while (now_s := time.perf_counter() - began_s) < DEAD_AT_S + 2.0:
            cycle()
            took_s = time.perf_counter() - began_s - now_s
            if now_s < DEAD_AT_S - 1.0:
                before.append(took_s)
            elif now_s > DEAD_AT_S + 0.5:
                after.append(took_s)
            deadline_ns = max(deadline_ns + 10_000_000, clock.now_ns())
            clock.sleep_until_ns(deadline_ns)
    return {
        "before_ms": round(1e3 * statistics.median(before), 2),
        "after_ms": round(1e3 * statistics.median(after), 2),
        "mean_extra_ms": round(1e3 * (statistics.fmean(after) - statistics.fmean(before)), 2),
    }


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=2.0, help="per turn")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    print(
        json.dumps(
            {
                "targets": TARGETS,
                "sync_read": compare(arguments.seconds, arguments.rounds, fast=False),
                "fast_sync_read": compare(arguments.seconds, arguments.rounds, fast=True),
                "armed": armed(arguments.seconds),
                "dead_servo": {"ours": dead_servo(our_cycle, True), "sdk": dead_servo(sdk_cycle, False)},
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
