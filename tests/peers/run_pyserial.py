"""Runs pyserial's own suite with an echo behind a port; prints what became of each test as JSON.

Usage: python run_pyserial.py FOLDER_OF_ITS_SOURCE [pty]

The port is `hil://peers`, in virtual time, or a terminal as `hil emulate` serves it.
"""

import contextlib
import importlib
import json
import sys
import threading
import unittest
from pathlib import Path

from run_python_can import Still

from hil.core.clock import MonotonicClock
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.world import World
from hil.faults.plan import FaultPlan

MODULES = (
    "test",
    "test_advanced",
    "test_cancel",
    "test_context",
    "test_high_load",
    "test_iolib",
    "test_readline",
    "test_settings_dict",
    "test_timeout_class",
    "test_url",
    "test_util",
)


class Echo(SerialChip):
    """TX and RX joined."""

    name, supported_faults = "peers", {}

    def receive(self, data, t_ns, baud):
        return [Reply(t_ns, data)]

    def reset(self, t_ns):
        pass


def cases(suite):
    for one in suite:
        yield from cases(one) if isinstance(one, unittest.TestSuite) else (one,)


@contextlib.contextmanager
def in_virtual_time(module):
    module.PORT = "hil://peers"
    line = SerialLine(World(Still(), seed=0, faults=FaultPlan([])), Echo(), latency_s=0.0).open()
    yield
    line.close()


@contextlib.contextmanager
def at_the_wire(module):
    world = World(Still(), seed=0, faults=FaultPlan([]))
    transport = SerialPty(SerialLine(world, Echo(), latency_s=0.0))
    server = EmulationServer(world, MonotonicClock(), {"peers": transport})
    module.PORT = transport.endpoint()["port"]
    thread = threading.Thread(target=server.run)
    thread.start()
    yield
    server.stop()
    thread.join()


def main():
    serving = at_the_wire if sys.argv[2:] == ["pty"] else in_virtual_time
    sys.path.insert(0, str(Path(sys.argv[1]) / "test"))
    result, names = unittest.TestResult(), []
    for name in MODULES:
        module = importlib.import_module(name)
        for test in cases(unittest.defaultTestLoader.loadTestsFromModule(module)):
            names.append(test.id())
            with serving(module):
                test.run(result)
    bad = {test.id(): text.strip().splitlines()[-1] for test, text in result.failures + result.errors}
    print(json.dumps({"run": names, "bad": bad, "skipped": {t.id(): why for t, why in result.skipped}}))


if __name__ == "__main__":
    main()
