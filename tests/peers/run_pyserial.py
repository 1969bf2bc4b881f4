"""Runs pyserial's own suite on `hil://peers` with an echo behind it; prints what became of each test as JSON.

Usage: python run_pyserial.py FOLDER_OF_ITS_SOURCE
"""

import importlib
import json
import sys
import unittest
from pathlib import Path

from run_python_can import Still

from hil.fakes.faults import FaultPlan
from hil.fakes.serial_line import SerialLine
from hil.fakes.wire import Reply, SerialChip
from hil.fakes.world import World

MODULES = ("test", "test_advanced", "test_cancel", "test_context", "test_high_load", "test_iolib",
           "test_readline", "test_settings_dict", "test_timeout_class", "test_url", "test_util")  # fmt: skip


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


def main():
    sys.path.insert(0, str(Path(sys.argv[1]) / "test"))
    result, names = unittest.TestResult(), []
    for name in MODULES:
        module = importlib.import_module(name)
        module.PORT = "hil://peers"
        for test in cases(unittest.defaultTestLoader.loadTestsFromModule(module)):
            line = SerialLine(World(Still(), seed=0, faults=FaultPlan([])), Echo(), latency_s=0.0).open()
            names.append(test.id())
            test.run(result)
            line.close()
    bad = {test.id(): text.strip().splitlines()[-1] for test, text in result.failures + result.errors}
    print(json.dumps({"run": names, "bad": bad, "skipped": {t.id(): why for t, why in result.skipped}}))


if __name__ == "__main__":
    main()
