"""A fan at the end of a CAN bus on loopback: takes commands, reports at 50 Hz, lets go after its timeout.

It is written from the protocol, not from our codec, and keeps when each command arrived by the kernel's
clock: so its own lateness on a busy machine is not mistaken for a gap.
"""

import struct
import threading
import time
from contextlib import contextmanager

import can

from hil.fakes.free_port import free_udp_port
from hil.fan_daemon.spec import Spec

GROUP = "239.74.164.9"
RELEASED_AFTER_S = 1.0
_LEAD_S = 0.02


class Fan:
    def __init__(self, port, controller_id):
        self.controller_id, self.duty, self.reports = controller_id, 0.0, True
        self.commands = []
        self._last_s = 0.0
        self._bus = can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        next_s = time.time()
        while not self._ended.is_set():
            message = self._bus.recv(max(0.0, min(_LEAD_S, next_s - time.time())))
            if message is not None:
                self._take(message)
            if time.time() >= next_s:
                next_s = time.time() + _LEAD_S
                if time.time() - self._last_s > RELEASED_AFTER_S:
                    self.duty = 0.0
                self._report()

    def _take(self, message):
        command, controller = message.arbitration_id >> 8, message.arbitration_id & 0xFF
        if command > 4 or controller != self.controller_id or not message.is_extended_id:
            return
        (raw,) = struct.unpack(">i", message.data[:4])
        self._last_s = message.timestamp
        self.duty = raw / 1e5 if command == 0 else self.duty if raw else 0.0
        self.commands.append((message.timestamp, command, raw))

    def _report(self):
        if self.reports:
            data = struct.pack(">ihh", round(1e5 * self.duty), round(500 * self.duty), round(1e3 * self.duty))
            self._bus.send(can.Message(arbitration_id=9 << 8 | self.controller_id, data=data))

    def duties(self):
        return [(t_s, raw / 1e5) for t_s, command, raw in list(self.commands) if command == 0]

    def gaps_s(self, since_s=0.0):
        times = [t_s for t_s, _, _ in list(self.commands) if t_s >= since_s]
        return [after - before for before, after in zip(times, [*times[1:], time.time()], strict=True)]

    def start(self):
        self._thread.start()

    def close(self):
        self._ended.set()
        self._thread.join()
        self._bus.shutdown()


@contextmanager
def fan_on_the_wire(controller_id=7):
    """A fan that runs, and what a daemon is given to it."""
    port = free_udp_port()
    fan = Fan(port, controller_id)
    fan.start()
    options = {"port": port, "hop_limit": 0}
    try:
        yield fan, Spec("udp_multicast", GROUP, controller_id, options=options)
    finally:
        fan.close()
