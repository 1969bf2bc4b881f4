"""Runs python-can's back-to-back suite; prints what became of each test as JSON.

Usage: python run_python_can.py FOLDER_OF_ITS_SOURCE [multicast]

Both ends are on interface `hil`, in virtual time, or in the multicast group of a bus that is served as
`hil emulate` does it.
"""

import contextlib
import functools
import json
import os
import sys
import threading
import unittest
import unittest.mock

import can

from hil.core.clock import MonotonicClock
from hil.fakes.can_bridge import CanTransport
from hil.fakes.can_channel import CanChannel
from hil.fakes.server import EmulationServer
from hil.fakes.world import World
from hil.faults.plan import FaultPlan


class Still:
    """A plant that is not observed."""

    t_ns = 0

    def advance(self, t_ns):
        self.t_ns = t_ns


def main():
    sys.path.insert(0, sys.argv[1])
    from test import back2back_test as suite

    world = World(Still(), seed=0, faults=FaultPlan([]))
    channel = CanChannel(world, "peers")
    with contextlib.ExitStack() as stack:
        if sys.argv[2:] == ["multicast"]:
            where = serve(stack, world, channel)
        else:
            stack.callback(channel.open().close)
            where = {"interface": "hil", "channel": "peers"}
        run(suite, where)


def serve(stack, world, channel):
    """Where the bus is, which is served until the stack is unwound."""
    transport = CanTransport(channel, address=f"239.74.164.{2 + os.getpid() % 250}", listens=True)
    server = EmulationServer(world, MonotonicClock(), {"peers": transport})
    thread = threading.Thread(target=server.run)
    thread.start()
    stack.callback(thread.join)
    stack.callback(server.stop)
    reported = transport.endpoint()
    return {key: reported[key] for key in ("interface", "channel", "port")}


def run(suite, where):
    more = {key: value for key, value in where.items() if key not in ("interface", "channel")}

    class OnHil(suite.Back2BackTestCase):
        INTERFACE_1 = INTERFACE_2 = where["interface"]
        CHANNEL_1 = CHANNEL_2 = where["channel"]

        def setUp(self):
            opened = functools.partial(can.Bus, **more)
            with unittest.mock.patch.object(suite.can, "Bus", opened):
                super().setUp()

    result = unittest.TestResult()
    tests = unittest.defaultTestLoader.loadTestsFromTestCase(OnHil)
    names = [test._testMethodName for test in tests]
    tests.run(result)
    bad = {
        test._testMethodName: text.strip().splitlines()[-1] for test, text in result.failures + result.errors
    }
    skipped = {test._testMethodName: why for test, why in result.skipped}
    print(json.dumps({"run": names, "bad": bad, "skipped": skipped}))


if __name__ == "__main__":
    main()
