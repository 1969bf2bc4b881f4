"""The microcontroller that reads four AS5045 chips and sends two CAN frames per sample set, and its status.

As in a real node, the frame layout is fixed in the firmware; a test checks it against the shipped DBC. The
node samples on its own clock, with jitter, and resets its counters on a restart.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.signals import WHEELS
from hil.fakes.can_channel import CanChannel
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.encoders.as5045.encoder import (
    CHIP_SIZE,
    COUNTS,
    OCF,
    OFFSET,
    START_UP_NS,
    EncoderTruthOptions,
    chip,
    with_parity,
    words,
)
from hil.fakes.world import Scheduled, World
from hil.faults.fault import IN, Fault, Supported
from hil.faults.messages import Messages
from hil.faults.plan import Once
from hil.support.numba_jit import compile_for

_OF_ALL: Supported = {
    "off": (),
    "stuck": (),
    "garbage": ("flags",),
    "wrong": ("offset_rad",),
    "jump": ("angle_rad",),
}
AXIS_FAULTS: Supported = {**_OF_ALL, "corrupt": ("probability",)}
NODE_FAULTS: Supported = {
    **_OF_ALL,
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "brownout": (),
    "reset": (),
}
FRAME_IDS = (0x1A0, 0x1A1, 0x1A2)

_TIME_LSB_NS = 10_000
_TIME_MASK = 0xFFFFF
_BOOT_NS = 50_000_000
_BLOCK, _WORD_BITS = 512, 18
_SLIP_RAD, _DELAY_S = 0.2, 0.05


class EncoderNode(Scheduled):
    """Encoder node that sends one sample set of two frames per period.

    Args:
        world: truth, seed and faults; the node registers itself there.
        wire: the CAN channel.
        name: device name of its faults; the axes are called `encoder.FL` and so on, those of a further device
            `encoders_rear.FL`.
        rate_hz: sample sets per second.
        node_id: added to the frame identifiers.
        sign, zero_rad: mounting direction and zero of the magnets, wheel order.
        jitter_s: standard deviation of the sampling instant.
        clock_ppm: error of the node's clock.
    """

    Options = EncoderTruthOptions
    announces = True

    @classmethod
    def build(cls, request: EmulationRequest, channel: CanChannel) -> EncoderNode:
        """Make the node from its table of the bench file."""
        config = request.config
        return cls(
            request.world,
            channel,
            name=request.kind,
            rate_hz=config.rate_hz,
            node_id=config.node_id,
            sign=config.sign,
            zero_rad=config.zeros_rad,
            options=request.options(cls.Options),
        )

    def __init__(
        self,
        world: World,
        wire: CanChannel,
        *,
        name: str = "encoders",
        rate_hz: float = 200.0,
        node_id: int = 0,
        options: EncoderTruthOptions | None = None,
        sign: tuple[int, ...] = (1, 1, 1, 1),
        zero_rad: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0),
        jitter_s: float = 100e-6,
        clock_ppm: float = 30.0,
    ) -> None:
        self.name = name
        self._world, self._wire = world, wire
        self._ids = tuple(frame_id + node_id for frame_id in FRAME_IDS)
        self._rng = world.rng(name)
        options = options if options is not None else EncoderTruthOptions()
        chips = [self._chip(options, s, z) for s, z in zip(sign, zero_rad, strict=True)]
        self._chips = np.array([number for numbers in chips for number in numbers], dtype=np.float64)
        begins = "encoder" if name == "encoders" else name
        self._axes = tuple(f"{begins}.{wheel}" for wheel in WHEELS)
        self._plan = world.faults.of(name, *self._axes)
        self._rate_hz = max(1, round(rate_hz))
        self._says = options.layout & 0xFF | (options.firmware & 0xFF) << 8
        self._period_ns = round(1e9 / rate_hz * (1.0 + 1e-6 * clock_ppm))
        self._rate_error = 1.0 - 1e-6 * clock_ppm
        self._jitter_ns = 1e9 * jitter_s
        self._noise, self._late, self._row = np.zeros((1, 5)), [0.0], 0
        compile_for(words, self._chips, 0.0, 0.0, 0.0, 0.0, self._noise, 0, 0)
        self._words = tuple(Messages(world.faults, (a,), self._rng, ("corrupt",)) for a in self._axes)
        self._once = Once()
        self._frozen: dict[str, int] = {}
        self._dead = self._first_set = False
        self._boot(0)
        wire.declare(name, NODE_FAULTS, ways=IN)
        for axis in self._axes:
            world.faults.declare(axis, AXIS_FAULTS)
        self._grid_ns = self._due_ns = int(self._rng.integers(0, self._period_ns))
        world.add(self)

    def next_due_ns(self) -> int:
        """Time of the next sample set."""
        return self._due_ns

    def on_due(self, t_ns: int) -> None:
        """Sample the four chips and send two frames."""
        row = self._draw()
        faulty = not self._plan.empty
        slow = self._plan.find(self.name, "slow", t_ns) if faulty else None
        period_ns = self._period_ns
        if slow is not None:
            period_ns = round(period_ns * slow.period_factor)
        grid_ns, late = self._grid_ns + period_ns, abs(self._late[row])
        self._grid_ns = grid_ns = grid_ns if grid_ns > t_ns else t_ns
        due_ns = grid_ns + round((late if late < 3.0 else 3.0) * self._jitter_ns)
        self._due_ns = due_ns if due_ns > t_ns else t_ns + 1
        if faulty and self._power(t_ns):
            return
        started = OCF if t_ns - self._boot_ns >= START_UP_NS else 0
        a, b, c, d = self._world.plant.steering_rad()
        reported = words(self._chips, a, b, c, d, self._noise, row, started)
        if self._first_set:
            self._first_set = False
            reported = tuple(self._rng.integers(0, 1 << 18, 4).tolist())
        send_ns = t_ns
        if faulty:
            reported = tuple([self._spoil(axis, word, t_ns) for axis, word in enumerate(reported)])
            delayed = self._plan.find(self.name, "delayed", t_ns)
            send_ns += delayed.delay_ns(_DELAY_S) if delayed is not None else 0
        self._send(reported, t_ns, send_ns)

    def reset(self, t_ns: int) -> None:
        """Power was cycled: counters restart, and the first words are random."""
        self._boot(t_ns + _BOOT_NS)

    def _boot(self, t_ns: int) -> None:
        self._boot_ns = t_ns
        self._sequence = 0
        self._first_set = True

    def _chip(self, options: EncoderTruthOptions, sign: int, zero_rad: float) -> list[float]:
        a1, a2 = (float(a) for a in self._rng.normal(0.0, (options.once_rad, options.twice_rad)))
        p1, p2 = (float(p) for p in self._rng.uniform(-math.pi, math.pi, 2))
        return chip(once=(a1, p1), twice=(a2, p2), noise_rad=options.noise_rad, sign=sign, zero_rad=zero_rad)

    def _draw(self) -> int:
        """Index of the next row of random numbers; draws a new block after the last one."""
        self._row += 1
        if self._row == len(self._late):
            drawn = self._rng.standard_normal((_BLOCK, 5))
            self._noise, self._late, self._row = drawn, drawn[:, 4].tolist(), 0
        return self._row

    def _send(self, words: tuple[int, ...], t_ns: int, send_ns: int) -> None:
        node_ns = round((t_ns - self._boot_ns) * self._rate_error)
        tail = (self._sequence & 0xFF) << 36 | (node_ns // _TIME_LSB_NS & _TIME_MASK) << 44
        self._sequence += 1
        left, right, status = self._ids
        self._wire.transmit(left, (words[0] | words[1] << 18 | tail).to_bytes(8, "little"), send_ns)
        self._wire.transmit(right, (words[2] | words[3] << 18 | tail).to_bytes(8, "little"), send_ns)
        if (self._sequence - 1) % self._rate_hz == 0:
            reported = self._says | (self._rate_hz & 0xFFF) << 16
            self._wire.transmit(status, reported.to_bytes(8, "little"), send_ns)

    def _power(self, t_ns: int) -> bool:
        """Apply faults of the whole node; True while it sends nothing."""
        find = self._plan.find
        was_dead, self._dead = self._dead, any(find(self.name, k, t_ns) for k in ("off", "brownout"))
        if was_dead and not self._dead:
            self.reset(t_ns)
        reset = self._once.first_activation("reset", find(self.name, "reset", t_ns))
        if reset is not None:
            self.reset(reset.start_ns)
        return self._dead or t_ns < self._boot_ns

    def _spoil(self, axis: int, word: int, t_ns: int) -> int:
        """Apply the faults of an axis and of the whole device to the word of that axis.

        Options: `wrong,offset_rad=` while active; `jump,angle_rad=` from its start on; `corrupt,
        probability=` of one axis flips one bit of its word; `off` is a chip without power; `garbage,flags=`
        sets status bits (magnet faults) instead of random words.
        """
        frozen = self._frozen
        self._frozen = {k: v for k, v in frozen.items() if self._stuck(k, t_ns)}
        for device in (self.name, self._axes[axis]):
            for fault in self._plan.active(device, t_ns):
                word = self._apply(fault, axis, word)
        sent = self._words[axis].damaged(word.to_bytes(3, "little"), t_ns, bits=_WORD_BITS)
        return int.from_bytes(sent, "little")

    def _stuck(self, key: str, t_ns: int) -> bool:
        return any(self._plan.find(device, "stuck", t_ns) is not None for device in (self.name, key))

    def _apply(self, fault: Fault, axis: int, word: int) -> int:
        kind, name = fault.kind, self._axes[axis]
        if kind == "off":
            return 0
        if kind == "stuck":
            return self._frozen.setdefault(name, word)
        if kind == "garbage":
            flags = int(fault.option("flags", 0))
            return with_parity(word | flags & 0x1E) if flags else int(self._rng.integers(0, 1 << _WORD_BITS))
        if kind == "wrong":
            return _turned(word, fault.option("offset_rad", _SLIP_RAD))
        if kind == "jump" and self._once.first_activation((name, kind), fault) is not None:
            self._chips[axis * CHIP_SIZE + OFFSET] += fault.option("angle_rad", _SLIP_RAD)
        return word


def _turned(word: int, offset_rad: float) -> int:
    """Return the word of the axis turned by `offset_rad`."""
    counts = (word >> 6) + round(offset_rad * COUNTS / (2.0 * math.pi))
    return with_parity(counts % COUNTS << 6 | word & 0x3F)
