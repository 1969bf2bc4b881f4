"""Every emulated device, alone in a world: spoilt requests for the chip, spoilt answers for the driver."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields
from typing import Any

import can
import numpy as np
import serial
from mutating import Seal, spoilt
from tapping import Tap, frame_of, tapped

from hil.bench.emulated_devices import build_world, connect_in_process
from hil.config.loading import load_bench
from hil.core.device import Connection, DeviceModel
from hil.core.errors import HilError
from hil.core.registry import kinds
from hil.core.signals import ServoSetpoint
from hil.fakes.world import VirtualClock, World

MODELS = [m for kind in kinds().values() for m in kind.models if m.emulate is not None]
NO_BYTES = ("t265",)  # its library hands over objects; what the feed of `hil emulate` says is a parser
_READS, _STEP_NS, _LONGEST_NS = 10, 500_000, 3_000_000_000
_TALKS = {"start": "running", "messages_1": [1, 4, 5]}
_DEEDS: tuple[dict[str, tuple[Any, ...]], ...] = (
    {"enable": (), "set_force_n": (2.0,)},
    {"ask": ()},
    {"command": (ServoSetpoint(np.zeros(4), np.full(4, 0.5)),)},
    {"read_health": ()},
    {"look_after": ()},
    {"set_duty": (0.2,)},
    {"stop": ()},
)


class Alone:
    """One emulated device, its world, and drivers for it."""

    def __init__(self, model: DeviceModel, seed: int) -> None:
        base = load_bench("emulated")
        table = {"model": model.name, "backend": "emulated"}
        tree: dict[str, Any] = {"schema": 1, "name": "fuzz", model.kind: table}
        known = {f.name for f in fields(model.truth_options())}
        tree["emulation"] = {model.kind: {key: _TALKS[key] for key in known & _TALKS.keys()}}
        self.config = type(base).model_validate(tree)
        self.world: World = build_world(self.config, seed=seed)
        self.clock = VirtualClock(self.world)
        self.connected = connect_in_process(self.config, self.world)
        self.connection: Connection = self.connected.connections[model.kind]
        self.model = model

    def driver(self) -> Any:
        """A new driver, closed."""
        table = self.config.devices()[self.model.kind].model_copy(update=dict(self.connection.values))
        return self.model.make_driver(table, self.clock, **self.connection.parts)

    def pass_time(self) -> None:
        """Half a millisecond of the world."""
        self.world.advance_to(self.world.now_ns + _STEP_NS)

    def close(self) -> None:
        """End it."""
        self.connected.close()


def _use(driver: Any, number: int) -> None:
    """One cycle: read; now and then what only actuators and fans can do."""
    with suppress(HilError):
        driver.read()
    for name, words in _DEEDS[number % len(_DEEDS)].items():
        if hasattr(driver, name):
            with suppress(HilError):
                getattr(driver, name)(*words)


def _used(driver: Any, alone: Alone) -> None:
    driver.open()
    for number in range(_READS):
        _use(driver, number)
        alone.clock.sleep_until_ns(alone.clock.now_ns() + 10_000_000)
    driver.close()


@contextmanager
def _recorded(model: DeviceModel, seed: int) -> Iterator[tuple[Alone, Tap]]:
    """A device, and what went over its wire while a driver opened it, read it and closed it."""
    with tapped() as tap:
        alone = Alone(model, seed)
        try:
            _used(alone.driver(), alone)
            yield alone, tap
        finally:
            tap.spoil = None
            alone.close()


def recorded(name: str) -> list[bytes]:
    """What an emulated device of a model says to its driver in a tenth of a second."""
    model = next(m for m in MODELS if m.name == name)
    with _recorded(model, 1) as (_, tap):
        return list(dict.fromkeys(tap.received))


def _sender(alone: Alone) -> tuple[Callable[[bytes], object], Callable[[], object]]:
    """How bytes get to the chip, and how that ends."""
    values, parts = alone.connection.values, alone.connection.parts
    if "port" in values:
        port = serial.serial_for_url(values["port"], baudrate=_baud(alone), timeout=0)

        def on_line(data: bytes) -> None:
            port.write(data)
            port.reset_input_buffer()

        return on_line, port.close
    if "channel" in values:
        bus = can.Bus(interface="hil", channel=values["channel"])

        def on_bus(data: bytes) -> None:
            bus.send(frame_of(data))
            while bus.recv(0) is not None:
                pass

        return on_bus, bus.shutdown
    if "datagrams" in parts:
        socket = parts["datagrams"](None, 0)

        def to_server(data: bytes) -> None:
            socket.send(data, ("127.0.0.1", 1510))
            while socket.receive() is not None:
                pass

        return to_server, socket.close
    link = parts["link"](alone.config.devices()[alone.model.kind], alone.clock, "fuzz")

    def to_computer(data: bytes) -> None:
        link.send(data, link.peer)
        while link.receive() is not None:
            pass

    return to_computer, link.close


def _baud(alone: Alone) -> int:
    return int(alone.config.devices()[alone.model.kind].baud)  # type: ignore[attr-defined]


def spoil_requests(
    model: DeviceModel, rng: np.random.Generator, cases: int, seal: Seal | None
) -> Iterator[bytes]:
    """Feed the chip; yields every request before it is sent."""
    with _recorded(model, int(rng.integers(1 << 30))) as (alone, tap):
        seeds = list(dict.fromkeys(tap.sent)) or [b"\0" * 13]
        send, done = _sender(alone)
        try:
            for _ in range(cases):
                data = spoilt(rng, seeds, seal)
                yield data
                send(data)
                alone.pass_time()
        finally:
            done()


def spoil_answers(
    model: DeviceModel, rng: np.random.Generator, cases: int, seal: Seal | None
) -> Iterator[bytes]:
    """Feed the driver; yields every answer before it gets it. Each tenth answer arrives as it was sent."""
    with _recorded(model, int(rng.integers(1 << 30))) as (alone, tap):
        seeds, given = list(dict.fromkeys(tap.received)), list[bytes]()
        if not seeds:
            return  # a device that never says anything

        def spoil(data: bytes) -> bytes:
            found = data if rng.random() < 0.1 else spoilt(rng, [data, *seeds] if data else seeds, seal)
            given.append(found)
            return found

        count = 0
        while count < cases:
            tap.spoil = None if rng.random() < 0.7 else spoil
            driver = alone.driver()
            try:
                driver.open()
                tap.spoil = spoil
                for number in range(200):
                    began_ns = alone.clock.now_ns()
                    _use(driver, number)
                    assert alone.clock.now_ns() - began_ns < _LONGEST_NS, "one cycle takes seconds"
                    alone.clock.sleep_until_ns(alone.clock.now_ns() + 5_000_000)
            except HilError:
                alone.pass_time()
            finally:
                with suppress(HilError):
                    driver.close()
            count += len(given)
            yield from given
            given.clear()
