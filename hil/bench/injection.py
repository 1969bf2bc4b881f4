"""Faults in front of the real devices of a bench: which are injected, when, and what they have hit."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from hil.bench.by_hand import Hand, HandFaults
from hil.bench.device_proxy import DeviceWithin
from hil.bench.device_set_from_config import model_of
from hil.bench.injected_travel import TravelBound, must_stay_near, seeing_a_slide
from hil.config.bench import BenchConfig
from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import FaultNotSupportedError
from hil.core.interfaces import Device, Sink
from hil.fakes.world import random_stream
from hil.faults import permission
from hil.faults.at_the_link import LinkFaults
from hil.faults.fault import Fault
from hil.faults.plan import FaultPlan
from hil.links.injection import in_front_of
from hil.robot.trajectories import Trajectory


def real_device(config: BenchConfig, fault: Fault) -> str:
    """Name of the real device of a fault; empty where the device is emulated or the bench has none."""
    name = fault.device if fault.device in config.devices() else fault.whole
    return name if name in config.devices() and name not in config.emulated() else ""


def at_links(config: BenchConfig, faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """Those faults of a bench whose device is real."""
    return tuple(fault for fault in faults if real_device(config, fault))


def check_links(
    config: BenchConfig, faults: Sequence[Fault], *, consent: bool, by_hand: bool = False
) -> None:
    """Refuse faults of real devices that must not be injected; nothing is opened.

    Args:
        config: the bench configuration.
        faults: faults whose device is real.
        consent: True if the command line asks for faults at the links of real devices.
        by_hand: True if an operator does those of the power.

    Raises:
        FaultNotSupportedError: names the first fault and the reason.
    """
    if not faults:
        return
    refused = [f for f in faults if not (by_hand if f.kind in permission.POWER else consent)]
    if first := next(iter(refused), None):
        power = first.kind in permission.POWER
        raise FaultNotSupportedError(
            f"fault {first}: {real_device(config, first)} of {config.name} is real",
            expected="faults of emulated devices",
            remedy=(
                "--by-hand asks the operator to switch the power"
                if power
                else "--inject-real (pytest: --hil-inject-real) injects it at the link"
            )
            + ", where [faults] of the bench file permits it; --emulate injects it at an emulated device",
        )
    for fault in faults:
        if fault.device != (whole := real_device(config, fault)):
            raise FaultNotSupportedError(
                f"fault {fault}: at a link all of {whole} has a fault, not a part of it",
                expected=f"{whole}:{fault.kind}",
            )
    real = {name: table for name, table in config.devices().items() if name not in config.emulated()}
    permission.check(
        faults,
        bench=config.name,
        wires={name: model_of(config, name).wire_of(table) for name, table in real.items()},
        seeing=seeing_a_slide(config),
        named=config.faults.devices,
        most=config.faults.real,
        present=permission.situation(on_wall=config.environment.on_wall, tethered=config.safety.tethered),
        by_hand=by_hand,
    )


def check_travel(config: BenchConfig, faults: Sequence[Fault], planned: Iterable[Trajectory]) -> None:
    """Refuse a planned trajectory that leads too far for faults at links, as `must_stay_near` does."""
    if _bounds_travel(config, at_links(config, faults)):
        for trajectory in planned:
            must_stay_near(trajectory)


def _bounds_travel(config: BenchConfig, faults: Sequence[Fault]) -> bool:
    """Whether faults of real devices limit how far the robot goes."""
    return bool(faults) and config.environment.on_wall and not config.safety.tethered


class Injection:
    """Faults in front of the real devices of one bench; without faults it does nothing.

    Args:
        config: the bench configuration.
        clock: clock of the bench.
        faults: faults of real devices, already checked.
        seed: seed of the draws.
        hand: operator who does those of the power; None for none.
    """

    def __init__(
        self,
        config: BenchConfig,
        clock: Clock,
        faults: Sequence[Fault] = (),
        seed: int = 0,
        hand: Hand | None = None,
    ) -> None:
        by_hand = [fault for fault in faults if fault.kind in permission.POWER]
        self._hands = (
            HandFaults(by_hand, hand, self._since_opened_ns) if hand is not None and by_hand else None
        )
        self._clock, self._config, self._seed = clock, config, seed
        self._given = tuple(faults)
        self._faults = tuple(fault for fault in faults if fault not in by_hand)
        self._plan = FaultPlan(map(permission.as_lasting, faults))
        self._links: list[LinkFaults] = []
        self._world_ns: Callable[[], int] = lambda: 0
        self._ended_ns: int | None = None
        bound = TravelBound(config, self._acts, lambda: self._plan.empty)
        self._bound = bound if _bounds_travel(config, faults) else None

    def sinks(self) -> tuple[Sink, ...]:
        """Sinks that stop a robot that has gone too far, and that ask the operator for faults."""
        return tuple(sink for sink in (self._bound, self._hands) if sink is not None)

    def _acts(self, name: str) -> bool:
        return bool(self._plan.active(name, self._world_ns()))

    def follow(self, world_ns: Callable[[], int]) -> None:
        """Take the time since the bench was opened, ns, from this function."""
        self._world_ns = world_ns

    def in_front_of(self, name: str, driver: Device) -> Device:
        """Return the driver of a real device, with its faults if it has any."""
        own = [fault for fault in self._faults if fault.device == name]
        if not own:
            return driver
        model = model_of(self._config, name)
        wire = model.wire_of(self._config.devices()[name])
        rng = random_stream(self._seed, f"link of {name}")
        kinds = tuple(permission.BY_WIRE[wire])
        link = LinkFaults(self._plan, name, rng, kinds, self._clock, self._since_opened_ns, model.framing)
        self._links.append(link)
        return DeviceWithin(driver, partial(in_front_of, link), driver.name)

    def _since_opened_ns(self) -> int:
        return self._world_ns()

    def disarm(self) -> None:
        """End all faults: from now on the robot is judged by what its devices send. Idempotent."""
        if self._ended_ns is None and not self._plan.empty:
            self._ended_ns = self._world_ns()
            self._plan.clear()
            if self._hands is not None:
                self._hands.end()

    def check(self, trajectory: Trajectory) -> None:
        """Refuse a trajectory that leads too far with these faults, as `must_stay_near` does."""
        if self._bound is None or self._plan.empty:
            return
        must_stay_near(trajectory, self._bound.began_at)

    def report(self) -> list[dict[str, object]]:
        """Each fault with begin and end, s since the bench was opened, and number of messages that it hit."""
        hit = {spec: count for link in self._links for spec, count in link.hit.items()}
        end_ns = self._world_ns() if self._ended_ns is None else self._ended_ns
        rows = [] if self._hands is None else self._hands.report(end_ns)
        return rows + [
            {
                "fault": str(fault),
                "at": "link",
                "begun_s": fault.start_ns / NS_PER_S if fault.start_ns <= end_ns else None,
                "ended_s": min(fault.end_ns or end_ns, end_ns) / NS_PER_S,
                "messages": hit.get(str(fault), 0),
            }
            for fault in self._faults
        ]

    def without_effect(self) -> tuple[Fault, ...]:
        """Faults that have begun and hit no message."""
        missed = {row["fault"] for row in self.report() if was_missed(row)}
        return tuple(fault for fault in self._given if str(fault) in missed)


def with_chips(
    rows: Sequence[dict[str, object]], faults: Sequence[Fault], end_ns: int
) -> list[dict[str, object]]:
    """Rows of `Injection.report`, and like ones of the other faults of a bench that ended at `end_ns`."""
    there = {row["fault"] for row in rows}
    return [*rows, *(_at_the_chip(fault, end_ns) for fault in faults if str(fault) not in there)]


def _at_the_chip(fault: Fault, end_ns: int) -> dict[str, object]:
    return {
        "fault": str(fault),
        "at": "chip",
        "begun_s": fault.start_ns / NS_PER_S if fault.start_ns <= end_ns else None,
        "ended_s": min(fault.end_ns or end_ns, end_ns) / NS_PER_S,
        "messages": None,
    }


def was_missed(row: Mapping[str, object]) -> bool:
    """Whether a fault of `Injection.report` has begun and hit no message, or was not done by hand."""
    return row["messages"] == 0 and (row["begun_s"] is not None or row["at"] == "hand")


def nothing_hit(faults: Sequence[object]) -> str:
    """One line for the user about faults that have hit no message; empty for none."""
    if not faults:
        return ""
    listed = ", ".join(map(str, faults))
    return f"fault {listed} has hit no message of its device: nothing that was done has met it"
