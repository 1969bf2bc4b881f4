"""Runs python-can's back-to-back suite on interface `hil`; prints what became of each test as JSON.

Usage: python run_python_can.py FOLDER_OF_ITS_SOURCE
"""

import json
import sys
import unittest

from hil.fakes.can_wire import CanChannel
from hil.fakes.faults import FaultPlan
from hil.fakes.world import World


class Still:
    """A plant that nobody looks at."""

    t_ns = 0

    def advance(self, t_ns):
        self.t_ns = t_ns


def main():
    sys.path.insert(0, sys.argv[1])
    from test import back2back_test as suite

    class OnHil(suite.Back2BackTestCase):
        INTERFACE_1 = INTERFACE_2 = "hil"
        CHANNEL_1 = CHANNEL_2 = "peers"

    channel = CanChannel(World(Still(), seed=0, faults=FaultPlan([])), "peers").open()
    result = unittest.TestResult()
    tests = unittest.defaultTestLoader.loadTestsFromTestCase(OnHil)
    names = [test._testMethodName for test in tests]
    tests.run(result)
    channel.close()
    bad = {
        test._testMethodName: text.strip().splitlines()[-1] for test, text in result.failures + result.errors
    }
    skipped = {test._testMethodName: why for test, why in result.skipped}
    print(json.dumps({"run": names, "bad": bad, "skipped": skipped}))


if __name__ == "__main__":
    main()
