"""The portable part of the encoder node, compiled for this machine, on pins that behave like four AS5045."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[2] / "firmware" / "as5045_node"
HALF_CLOCK_NS = 500


class Status(ctypes.Structure):
    _fields_ = (
        ("firmware", ctypes.c_uint8),
        ("rate_hz", ctypes.c_uint16),
        ("reset_cause", ctypes.c_uint8),
        ("parity_errors", ctypes.c_uint8),
        ("late_sets", ctypes.c_uint8),
        ("unsent_frames", ctypes.c_uint8),
        ("times_off_bus", ctypes.c_uint8),
    )


NOW = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)
PIN = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_bool)
BYTE = ctypes.CFUNCTYPE(ctypes.c_uint8, ctypes.c_void_p)
CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
SEND = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_uint32, ctypes.POINTER(ctypes.c_uint8))


class Board(ctypes.Structure):
    _fields_ = (
        ("context", ctypes.c_void_p),
        ("now_us", NOW),
        ("select", PIN),
        ("clock", PIN),
        ("data", BYTE),
        ("wait_half_clock", CALL),
        ("take_back", BYTE),
        ("send", SEND),
        ("times_off_bus", BYTE),
        ("feed_watchdog", CALL),
    )


class Node(ctypes.Structure):
    _fields_ = (
        ("board", ctypes.POINTER(Board)),
        ("address", ctypes.c_uint32),
        ("period_us", ctypes.c_uint32),
        ("due_us", ctypes.c_uint32),
        ("last_us", ctypes.c_uint32),
        ("time_us", ctypes.c_uint64),
        ("sets", ctypes.c_uint32),
        ("status", Status),
    )


class Chips:
    """Four AS5045 on shared CSn and CLK: what the datasheet says of their pins, and its limits of time."""

    def __init__(self):
        self.words = [0, 0, 0, 0]
        self.selected = False
        self.clock_high = True
        self._held = self._left = None
        self._edge_ns = -HALF_CLOCK_NS
        self.readings = 0

    def _edge(self, t_ns):
        assert t_ns - self._edge_ns >= HALF_CLOCK_NS, "faster than 1 MHz"
        self._edge_ns = t_ns

    def select(self, low, t_ns):
        if low != self.selected:
            self._edge(t_ns)
            assert self.clock_high, "CSn moves while CLK is high"
            self.selected, self._held, self._left = low, None, 18

    def clock(self, high, t_ns):
        if high == self.clock_high:
            return
        self._edge(t_ns)
        self.clock_high = high
        if self.selected and not high and self._held is None:
            self._held = list(self.words)
            self.readings += 1
        elif self.selected and high:
            self._left -= 1

    def data(self, t_ns):
        assert t_ns - self._edge_ns >= 413, "DO is not valid yet"
        assert 0 <= self._left < 18
        return sum((word >> self._left & 1) << i for i, word in enumerate(self._held))


class HostBoard:
    """A board whose time passes only while the node waits, and as the test says."""

    def __init__(self, library, *, address=0, rate_hz=200, start_us=0, cause=0):
        self.t_ns = start_us * 1000
        self.chips = Chips()
        self.sent, self.waiting, self.room = [], 0, 3
        self.off_bus = self.fed = 0
        self._library = library
        self.board = Board(
            None,
            NOW(lambda _: self.t_ns // 1000 & 0xFFFFFFFF),
            PIN(lambda _, low: self.chips.select(low, self.t_ns)),
            PIN(lambda _, high: self.chips.clock(high, self.t_ns)),
            BYTE(lambda _: self.chips.data(self.t_ns)),
            CALL(self._wait),
            BYTE(self._take_back),
            SEND(self._send),
            BYTE(lambda _: self.off_bus),
            CALL(self._feed),
        )
        self.node = Node()
        library.node_begin(ctypes.byref(self.node), ctypes.byref(self.board), address, rate_hz, cause)

    def _wait(self, _):
        self.t_ns += HALF_CLOCK_NS

    def _take_back(self, _):
        waiting, self.waiting = self.waiting, 0
        return waiting

    def _send(self, _, frame_id, data):
        if self.waiting >= self.room:
            return False
        if self.room < 3:
            self.waiting += 1
        self.sent.append((frame_id, bytes(data[:8])))
        return True

    def _feed(self, _):
        self.fed += 1

    def poll(self):
        return self._library.node_poll(ctypes.byref(self.node))

    def pass_until(self, t_us):
        """Poll every 10 us, as the loop of a board does, until a moment of its clock."""
        while self.t_ns < t_us * 1000:
            if not self.poll():
                self.t_ns += 10_000

    def next_set(self):
        """The frames of the next set, without the polls before it."""
        del self.sent[:]
        wait_us = (self.node.due_us - self.t_ns // 1000) & 0xFFFFFFFF
        self.t_ns += wait_us * 1000 if wait_us < 1 << 31 else 0
        assert self.poll()
        return list(self.sent)


def host_library(folder):
    """The portable part, compiled here with every warning an error."""
    if not shutil.which("cc") or not shutil.which("make"):
        pytest.skip("no C compiler: install gcc and make")
    subprocess.run(["make", "-C", FIRMWARE, f"OUT={folder}", "host"], check=True, capture_output=True)
    library = ctypes.CDLL(str(folder / "libnode.so"))
    library.node_begin.argtypes = (
        ctypes.POINTER(Node),
        ctypes.POINTER(Board),
        ctypes.c_uint32,
        ctypes.c_uint32,
        ctypes.c_uint8,
    )
    library.node_begin.restype = None
    library.node_poll.argtypes, library.node_poll.restype = (ctypes.POINTER(Node),), ctypes.c_bool
    library.as5045_parity_holds.argtypes = (ctypes.c_uint32,)
    library.as5045_parity_holds.restype = ctypes.c_bool
    return library
