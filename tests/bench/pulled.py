"""Emulated devices in real time whose plugs are pulled at known times: ports vanish as real ones do."""

import errno
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from hil.bench.drivers import model_of
from hil.bench.emulation import build_world, emulated
from hil.config.loading import load_bench
from hil.devices.emulated import SerialWired
from hil.devices.tracker.mavlink.computer import VisualInertialComputer
from hil.devices.tracker.mavlink.serial import SerialComputer
from hil.fakes.fault import parse_fault
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer, Face
from hil.fakes.world import NEVER_NS
from hil.vocabulary import host_multicast
from hil.vocabulary.clock import MonotonicClock
from hil.vocabulary.host_multicast import HostMulticastBus


@dataclass(frozen=True)
class Pulls:
    """When a plug is out: `times` times, from `first_s` of world time on, once every `period_s`."""

    times: int
    period_s: float
    away_s: float
    first_s: float

    def out(self, t_ns):
        number, phase_s = divmod(t_ns * 1e-9 - self.first_s, self.period_s)
        return 0 <= number < self.times and phase_s < self.away_s

    def changes_after(self, t_ns):
        """The next time at which the plug is pulled or put in, ns."""
        number, phase_s = divmod(t_ns * 1e-9 - self.first_s, self.period_s)
        number, phase_s = (0, -1.0) if number < 0 else (number, phase_s)
        later = self.away_s if phase_s >= 0 and phase_s < self.away_s else self.period_s * (phase_s >= 0)
        at_s = self.first_s + number * self.period_s + later
        return NEVER_NS if number >= self.times else round(at_s * 1e9) + 1000

    @property
    def end_s(self):
        return self.first_s + self.times * self.period_s

    def faults(self, device):
        return [
            parse_fault(f"{device}:unplug@{self.first_s + k * self.period_s:.6f}+{self.away_s}")
            for k in range(self.times)
        ]


class PulledPty(Face):
    """A serial line on a terminal that hangs up when its plug is pulled, and comes back under another name.

    `link` leads to the terminal of the day, as a link in `/dev/serial/by-id` does. A device that is `fed` by
    its adapter starts anew.
    """

    def __init__(self, world, line, link, pulls, fed):
        self.world, self.line, self.link, self.pulls, self.fed = world, line, link, pulls, fed
        self.pty, self.change_ns, self.plugged = None, 0, 0
        self.plug()

    def plug(self):
        self.plugged += 1
        taken = os.openpty() if self.plugged % 2 else ()  # so that the terminal has another number
        self.pty = SerialPty(self.line)
        for fd in taken:
            os.close(fd)
        self.link.symlink_to(self.pty.endpoint()["port"])

    def pull(self):
        self.link.unlink()
        self.pty.close()
        self.pty = None
        if self.fed:
            self.line.chip.reset(self.world.now_ns)

    def next_due_ns(self):
        due_ns = self.line.next_arrival_ns() if self.pty is None else self.pty.next_due_ns()
        return min(due_ns, self.change_ns)

    def on_due(self, t_ns):
        if t_ns >= self.change_ns:
            self.change_ns = self.pulls.changes_after(t_ns)
            if self.pulls.out(t_ns) and self.pty is not None:
                self.pull()
            elif not self.pulls.out(t_ns) and self.pty is None:
                self.plug()
        if self.pty is None:
            self.line.take(4096)
        elif self.pty.next_due_ns() <= t_ns:
            self.pty.on_due(t_ns)

    def filenos(self):
        return [] if self.pty is None else self.pty.filenos()

    def on_readable(self, fd, t_ns):
        if self.pty is not None:
            self.pty.on_readable(fd, t_ns)

    def endpoint(self):
        return {"port": str(self.link)}

    def close(self):
        if self.pty is not None:
            self.pull()


class PulledBus(HostMulticastBus):
    """A CAN adapter that can be pulled: every call fails as one of a network interface that is gone does."""

    out = staticmethod(lambda: False)

    def __init__(self, *args, **kwargs):
        self.check()
        super().__init__(*args, **kwargs)

    def check(self):
        if self.out():
            raise OSError(errno.ENETDOWN, "Network is down")

    def _recv_internal(self, timeout):
        self.check()
        return super()._recv_internal(timeout)


def served_faces(config, folder, pulls):
    """World and faces of a bench; what has no terminal is unplugged by its own fault."""
    datagrams = [n for n in config.devices() if not hasattr(config.devices()[n], "baud")]
    plan = [fault for n in datagrams if n != "encoders" for fault in pulls.faults(n)]
    world = build_world(config, seed=1, faults=plan)

    def face(name):
        table, link = config.devices()[name], folder / f"usb-{name}"
        if table.model == "mavlink":
            computer = VisualInertialComputer(world, mount_position_m=table.mount_position_m)
            line = SerialLine(world, SerialComputer(computer, baud=table.baud))
            return PulledPty(world, line, link, pulls, fed=False)
        device = emulated(config, world, name, name)
        if not isinstance(device, SerialWired):
            return device.serve()
        return PulledPty(world, device.line, link, pulls, fed=table.model == "bno055")

    return world, {name: face(name) for name in config.devices()}


def main(file, times, period_s, away_s, first_s):
    """Serve a bench file until standard input ends; one line says where, and when world time began."""
    pulls = Pulls(int(times), float(period_s), float(away_s), float(first_s))
    world, faces = served_faces(load_bench(file), Path(file).parent, pulls)
    server = EmulationServer(world, MonotonicClock(), faces, lifeline=sys.stdin.fileno())
    began_s = time.monotonic() - world.now_ns * 1e-9
    print(json.dumps({"began_s": began_s, "endpoints": server.endpoints()}), flush=True)
    server.run()


class Served:
    """A process that serves the devices of a bench file and pulls their plugs as planned."""

    def __init__(self, text, folder, pulls, monkeypatch):
        file = folder / "bench.toml"
        file.write_text(
            f'schema = 1\nname = "pulled"\n[environment]\nsurface = "floor"\ntilt_rad = 0.0\n{text}'
        )
        self.config, self.pulls = load_bench(file), pulls
        for name, table in self.config.devices().items():
            # importing it takes its time, too
            model_of(self.config, name).make_driver(
                table, MonotonicClock()
            )  # importing it takes its time, too
        arguments = map(str, (file, pulls.times, pulls.period_s, pulls.away_s, pulls.first_s))
        self.process = subprocess.Popen(
            [sys.executable, __file__, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        told = json.loads(self.process.stdout.readline())
        self.began_s, self.endpoints = told["began_s"], told["endpoints"]
        PulledBus.out = staticmethod(lambda: pulls.out(self.now_s() * 1e9))
        monkeypatch.setattr(host_multicast, "HostMulticastBus", PulledBus)

    def now_s(self):
        """World time."""
        return time.monotonic() - self.began_s

    def stop(self):
        self.process.communicate(timeout=10)


if __name__ == "__main__":
    main(*sys.argv[1:])
