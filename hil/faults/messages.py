"""The one rule of what becomes of a message on a wire: lost, damaged, cut short, doubled, in pieces.

A message is one reply of a bus, one packet of a stream, one frame or one datagram. A fault with a probability
draws once for each message. Emulated devices use the rule at their wires; it knows neither device nor wire.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from hil.core.clock import nanoseconds
from hil.faults.fault import BOTH, IN, PERIODIC, Fault, Supported
from hil.faults.plan import FaultPlan

ARRIVAL_FAULTS: Supported = {
    "drop": ("probability",),
    "duplicate": ("probability",),
    "intermittent": PERIODIC,
    "silent": (),
}
"""Faults of any wire: messages that do not arrive, or twice."""
FRAME_FAULTS: Supported = {
    **ARRIVAL_FAULTS,
    "corrupt": ("probability",),
    "truncate": ("probability",),
    "garbage": (),
}
"""Faults of a wire that carries frames or datagrams."""
STREAM_FAULTS: Supported = {**FRAME_FAULTS, "pieces": ("size", "gap_s")}
"""Faults of a wire that carries bytes."""
PIECE_BYTES, GAP_S = 8, 0.0002
"""Defaults of `pieces`."""
_BITS = 8


def declared(own: Supported, wire: Supported, faults: Supported, ways: str = BOTH) -> Supported:
    """Return the faults of a device and its wire; those that both have are the device's.

    Args:
        own: faults of the device.
        wire: further faults of the wire.
        faults: those of them that follow the rule of this module.
        ways: directions of the wire; those of one direction have no option `direction`.
    """
    added = ("direction",) if ways == BOTH else ()
    return {**own, **{kind: (*options, *added) for kind, options in faults.items()}, **wire, **own}


class Messages:
    """Messages of one wire, as its faults leave them.

    Args:
        plan: fault plan of the run.
        names: names of the device at the wire, any of which a fault may use.
        rng: random numbers of the draws.
        kinds: kinds of faults that the wire produces.
        way: direction of faults that give none, `IN` or `OUT`.
        on_hit: called with each fault that has withheld or altered a message; by default nothing is.

    Attributes:
        unharmed: True if no fault is or was planned for the device, so that callers can skip the rule.
    """

    def __init__(
        self,
        plan: FaultPlan,
        names: tuple[str, ...],
        rng: np.random.Generator,
        kinds: Iterable[str],
        *,
        way: str = IN,
        on_hit: Callable[[Fault], None] = lambda fault: None,
    ) -> None:
        self._on_hit = on_hit
        self._names, self._rng, self._kinds, self._way = names, rng, frozenset(kinds), way
        self._view = plan.of(*names)

    @property
    def unharmed(self) -> bool:
        """Whether no fault is planned for the device, nor has been."""
        return self._view.empty

    def leave_out(self, kinds: Iterable[str]) -> None:
        """Leave kinds of faults to the device itself."""
        self._kinds = self._kinds.difference(kinds)

    def find(self, kind: str, t_ns: int, way: str = IN) -> Fault | None:
        """Return the fault of this kind that acts on messages of this way now, or None."""
        if self._view.empty or kind not in self._kinds or not self._view.has(kind):
            return None
        for name in self._names:
            fault = self._view.find(name, kind, t_ns)
            if fault is not None and fault.strikes(way, self._way):
                return fault
        return None

    def copies(self, t_ns: int, way: str = IN) -> int:
        """Return how many times a message arrives that is sent now: 0, 1 or 2."""
        pausing = self.find("intermittent", t_ns, way)
        silent = self.find("silent", t_ns, way)
        if silent is None and pausing is not None and pausing.silences(t_ns):
            silent = pausing
        if silent is not None:
            self._on_hit(silent)
            return 0
        if self._hit("drop", t_ns, way):
            return 0
        return 2 if self._hit("duplicate", t_ns, way) else 1

    def damaged(self, data: bytes, t_ns: int, way: str = IN, *, bits: int | None = None) -> bytes:
        """Return the bytes that arrive of a message, perhaps random, cut short or with one flipped bit.

        Args:
            data: the message.
            t_ns: time at which it is sent.
            way: its direction.
            bits: number of its bits that are sent, lowest bit of the first byte first; all by default.
        """
        if (garbage := self.find("garbage", t_ns, way)) is not None:
            self._on_hit(garbage)
            data = self._rng.bytes(len(data))
        if data and self._hit("truncate", t_ns, way):
            data = data[: int(self._rng.integers(len(data)))]
        if data and self._hit("corrupt", t_ns, way):
            place = int(self._rng.integers(_BITS * len(data) if bits is None else bits))
            flipped = bytearray(data)
            flipped[place // _BITS] ^= 1 << place % _BITS
            data = bytes(flipped)
        return data

    def received(self, data: bytes, t_ns: int, way: str = IN) -> tuple[bytes, ...]:
        """Return the messages that arrive for one that is sent: none, one or two, intact or damaged."""
        if self._view.empty:
            return (data,)
        copies = self.copies(t_ns, way)
        return (self.damaged(data, t_ns, way),) * copies if copies else ()

    def pieces(self, data: bytes, t_ns: int, way: str = IN) -> Iterator[tuple[int, bytes]]:
        """Yield the pieces in which a message arrives, each with the pause before it, ns."""
        fault = self.find("pieces", t_ns, way)
        gap_ns, whole = 0, data
        while fault is not None and data:
            most = 2 * int(fault.option("size", PIECE_BYTES))
            size = int(self._rng.integers(1, most))
            if size >= len(data):
                break
            if data is whole:
                self._on_hit(fault)
            yield gap_ns, data[:size]
            data, gap_ns = data[size:], nanoseconds(fault.option("gap_s", GAP_S))
        if data:
            yield gap_ns, data

    def _hit(self, kind: str, t_ns: int, way: str) -> bool:
        fault = self.find(kind, t_ns, way)
        hits = fault is not None and fault.hits(self._rng)
        if fault is not None and hits:
            self._on_hit(fault)
        return hits
