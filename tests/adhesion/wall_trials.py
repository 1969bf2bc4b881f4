"""Wall runs in real time, killed: robot, bench and daemon in a process each."""

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from math import dist
from pathlib import Path

import can
import tomli_w
from kills import both, daemon_pid, wait_until

from hil.bench import open_bench
from hil.bench.fan_commands import daemon_spec
from hil.config.loading import load_bench
from hil.core.device import Connection
from hil.core.registry import kinds
from tests.patience import FANLESS, PATIENT

FOLDER = Path(__file__).parent
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(FOLDER.parents[1]), *sys.path])}
HALF_BLIND = "tracker:drop@0.1,probability=0.5"
_SET_COMMANDS = range(5)


@dataclass(frozen=True)
class WallKill:
    """One trial: the longest gap between commands; whether the robot hung still a moment later."""

    gap_s: float
    held: bool


class Robot:
    """The emulated robot: where its devices are, and the truth about it."""

    def __init__(self, process, overrides):
        self._process, self._overrides, self.pid = process, overrides, process.pid
        self.endpoints = json.loads(process.stdout.readline())

    def truth(self):
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def kill(self):
        """Let the robot be gone, with all its devices."""
        self._process.kill()

    def bench_file(self, folder):
        """A bench file in which all its devices are real."""
        config, tables = load_bench("emulated", overrides=self._overrides), {}
        for name, table in config.devices().items():
            kind = kinds()[name]
            model, endpoint = kind.model(table.model), self.endpoints[kind.shown_as]
            values = model.connection(endpoint)
            values = values.values if isinstance(values, Connection) else values
            tables[name] = table.model_copy(update={**values, "backend": "real"})
        real = config.model_copy(update=tables)
        tree = real.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_unset=True)
        tree["environment"]["start_pose"] = [0.0, 0.0, 0.0]
        tree["faults"] = {"real": "wall", "devices": ["tracker"]}
        tree.pop("emulation", None)
        path = folder / "robot.toml"
        path.write_text(tomli_w.dumps(tree))
        return path


@contextmanager
def robot_on_the_wall(seed, *, fan=True):
    """An emulated robot in a process of its own; without a fan something else presses it on, patiently."""
    command = [sys.executable, str(FOLDER / "wall_robot.py"), str(seed), *(() if fan else ("fanless",))]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT
    ) as process:
        yield Robot(process, {} if fan else {**FANLESS, **PATIENT})
        process.stdin.close()


@contextmanager
def bench_driving(path, *options):
    """A bench that drives on the wall, in a process of its own; `patient` with a busy computer."""
    command = [sys.executable, str(FOLDER / "wall_bench.py"), str(path), *options]
    log = path.with_name("bench.log")
    with (
        log.open("w") as said,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, env=ENVIRONMENT) as process,
    ):
        try:
            assert process.stdout.readline() == b"driving\n", log.read_text()
            yield process
        finally:
            process.kill()


class Commands:
    """When commands for the fan were on the bus, by the kernel's clock."""

    def __init__(self, path):
        spec = daemon_spec(load_bench(str(path)))
        self._id = spec.controller_id
        self._bus = can.Bus(interface=spec.interface, channel=spec.channel, **spec.options)

    def longest_gap_s(self, duration_s):
        """Longest time between two commands from now on."""
        while self._bus.recv(0) is not None:
            pass
        end_s, times = time.time() + duration_s, []
        while time.time() < end_s:
            message = self._bus.recv(0.02)
            if message is None or message.arbitration_id & 0xFF != self._id:
                continue
            if message.arbitration_id >> 8 in _SET_COMMANDS:
                times.append(message.timestamp)
        pairs = zip(times, [*times[1:], end_s], strict=True)
        return max((after - before for before, after in pairs), default=duration_s)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._bus.shutdown()


def killed(robot, commands, pid, rng):
    """Kill a process at a random moment and look at the bus and at the robot."""
    time.sleep(rng.uniform(0.0, 3.0))
    timer = threading.Timer(0.2, os.kill, (pid, signal.SIGKILL))
    timer.start()
    gap_s = commands.longest_gap_s(1.2)
    timer.join()
    return gap_s, robot.truth()


def benches_killed(robot, path, count, seed, faults=()):
    """Benches killed while they drive, perhaps with faults, each followed by another that takes over."""
    rng, found = random.Random(seed), []
    with Commands(path) as commands:
        for _ in range(count):
            with bench_driving(path, *faults) as process:
                gap_s, before = killed(robot, commands, process.pid, rng)
            time.sleep(0.5)
            after = robot.truth()
            still = dist(before["pose"][:2], after["pose"][:2]) < 5e-4
            found.append(WallKill(gap_s, still and not after["fallen"]))
    return found


def poses_per_s(path, duration_s=3.0):
    """Poses of the camera per second on a bench without faults, which sends 200 of them."""
    with open_bench(path) as bench:
        return sum(len(record.inputs.tracker) for record in bench.observe(duration_s).records) / duration_s


def daemons_killed(robot, path, count, seed):
    """Daemons killed while one bench drives on."""
    spec = daemon_spec(load_bench(str(path)))
    rng, found = random.Random(seed), []
    with Commands(path) as commands, bench_driving(path):
        for _ in range(count):
            _, daemon = wait_until(lambda: both(spec), "a standby")
            gap_s, truth = killed(robot, commands, daemon, rng)
            found.append(WallKill(gap_s, not truth["fallen"] and daemon_pid(spec) not in (None, daemon)))
    return found
