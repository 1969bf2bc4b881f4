"""What a kind of device is, and which kinds and models there are: everything about devices follows this.

A kind (`imu`) is what the rest of the bench knows: its samples, how they are judged, recorded and drawn. A
model of it (`bno055`) is a thing that one can buy: its table in the bench file, its driver, and what speaks
like it where the bench emulates it. `model = "..."` in the bench file chooses.

The shipped kinds are packages of `hil.devices`, named like the fields of `hil.vocabulary.signals.Inputs`.
An installed package adds kinds, or models to a kind, by entry points of the group `hil.devices`, each of
which names a `DeviceKind` or a `DeviceModel`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, NamedTuple

from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import ConfigError, HilError
from hil.vocabulary.finding import Finding
from hil.vocabulary.geometry import Array
from hil.vocabulary.interfaces import Device
from hil.vocabulary.kind_checks import add_kind, add_model
from hil.vocabulary.signals import KINDS, Inputs

GROUP = "hil.devices"
_OURS = "hil.devices"

Figures = Mapping[str, float]


@dataclass(frozen=True)
class Connection:
    """Where an emulated device in this process is to be found.

    Attributes:
        values: keys of its table in the bench file that say where (`port`, `channel`, ...).
        parts: what stands in for objects of a vendor's library: keyword arguments of the driver.
        close: frees what it occupies.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, Any] = field(default_factory=dict)
    close: Callable[[], None] = lambda: None


class Found(NamedTuple):
    """A device that discovery has found.

    Attributes:
        table: keys of its table in the bench file.
        notes: what a person should know of it.
        parts: what it consists of, for example each servo of a bus: dataclasses.
    """

    table: Mapping[str, Any]
    notes: tuple[str, ...] = ()
    parts: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Search:
    """What discovery may ask beside serial ports.

    Attributes:
        given: by kind, tables of devices that the user named.
        clock: for time-outs.
        say: receives progress.
        sysfs: where the kernel lists its devices.
        found: by kind, tables of what has been found so far.
    """

    given: Mapping[str, Sequence[Any]]
    clock: Clock
    say: Callable[[str], None]
    sysfs: Path
    found: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def opens(device: Device) -> bool:
    """Whether a device opens; it is closed again."""
    try:
        device.open()
    except HilError:
        return False
    device.close()
    return True


@dataclass(frozen=True)
class DeviceModel:
    """One model within a kind.

    Attributes:
        kind: name of the kind.
        name: as `model = "..."` in the bench file says it.
        title: as a person says it, for example `BNO055 on a serial port`.
        config: its table in the bench file, a subclass of `hil.config.device.DeviceConfig`.
        driver: makes the driver, closed, of config, clock and the parts of a `Connection` by name.
        emulate: makes the emulated device of a `hil.devices.emulated.Setting`; None where there is none.
        imperfections: gives the dataclass of what may be wrong with the emulated one: `[emulation.KIND]`.
        ask: asks a serial port whether the model is there. It changes no setting of a device.
        ask_writes: what `ask` writes to the port, in words; empty where it only listens.
        usb: (vendor, product) ids of adapters that are this model: `ask` of no model writes to them.
        search: looks for it elsewhere.
        ask_after: models with a smaller number are asked first: those that answer quickly.
        look: what `hil doctor` says of it beside the kind's own look; as `DeviceKind.look`.
        reach: keys of its table from the endpoint that `hil emulate` printed, or a `Connection`; the same
            keys when None.
        package: name and version of the package that it comes from; filled in when it is loaded.
    """

    kind: str
    name: str
    title: str
    config: type[Any]
    driver: Callable[..., Device]
    emulate: Callable[[Any], Any] | None = None
    imperfections: Callable[[], type[Any]] | None = None
    ask: Callable[[str, Clock], Found | None] | None = None
    ask_writes: str = ""
    usb: tuple[tuple[int, int], ...] = ()
    search: Callable[[Search], Found | None] | None = None
    ask_after: int = 5
    look: Callable[[Any], Iterable[Finding]] | None = None
    reach: Callable[[Mapping[str, Any]], Mapping[str, Any] | Connection] | None = None
    package: str = "hil"


class Topic(NamedTuple):
    """A ROS 2 topic on which a kind's samples are recorded.

    Attributes:
        name, type: of the topic, for example `/imu/data` and `sensor_msgs/msg/Imu`.
        message: the message of (sample, `hil.recording.ros_types.MessageMaker`).
    """

    name: str
    type: str
    message: Callable[[Any, Any], Any]


class Plot(NamedTuple):
    """A plot of the monitor: its tab, title, and the entity that `DeviceKind.figures` gives it."""

    tab: str
    title: str
    entity: str


class Force(NamedTuple):
    """A force on the robot that the monitor draws as an arrow.

    Attributes:
        name: of what makes it: `fan`.
        place_m: (3,) where it acts, in the body.
        force_n: (3,) in the body.
    """

    name: str
    place_m: Array
    force_n: Array


@dataclass(frozen=True)
class Witness:
    """How a kind's samples tell whether the robot moves.

    Attributes:
        still: by how much `value` may seem to change, within 0.2 s, while the robot rests.
        value: (k,) from a sample; None where it cannot be used.
        is_place: whether `value` is a position in m, which says how far the robot went; where `still` is more
            than a millimetre, only a way of more than `still`.
    """

    still: float
    value: Callable[[Any], Array | None]
    is_place: bool = False


@dataclass(frozen=True)
class DeviceKind:
    """What the bench knows of a kind of device.

    Attributes:
        name: of its table in the bench file, its field or key in `Inputs`, its faults and its topics.
        noun: as sentences call it: `camera`.
        sample: dataclass of its samples: a `stamp` and a `status` (one, or one for each channel), scalars
            and arrays.
        models: what there is of it; the first is meant where the bench file names none.
        actuates: whether it does something to the robot: a moving kind is opened last and closed first.
        holds: whether what it does keeps the robot on its surface (`hil.vocabulary.interfaces.Holding`): it
            is opened first, closed last, and a stop leaves it alone.
        guards: whether what it says shows how firmly the robot is held: a run that leaves devices out keeps
            it, as it keeps those that hold.
        aliases: further names that people give it.
        endpoint: its name in what `hil emulate` prints, where that is not its own.
        labels: names of the channels, where `status` has several.
        stale_s: time without a good sample after which it counts as silent, of the tables (safety, own);
            None for never.
        rate_hz: samples per second of a healthy device, of (its table, loop rate); NaN where its owner
            chooses.
        age_s: how old its samples may be when they arrive, at rest.
        gap_s: longest gap between good samples that is still healthy.
        delivered: least share of the samples that have to be good.
        own_clock: whether samples carry the device's own time.
        topics: where its samples are recorded.
        figures: what the monitor draws of a cycle: (entity, figures by name) for each plot.
        plots: where the monitor draws them.
        forces: what a cycle's samples tell of forces on the robot, of (inputs, `[robot]` of the bench file,
            its own table or None); the monitor draws them instead of those that `[robot]` promises.
        witness: how it notices that the robot moves; None if it cannot.
        look: findings of `hil doctor`, of a `hil.devices.looks.Watched`; its samples are counted when None.
        passes: by fault, why it may pass without a word: which data do not change, or that nobody notices;
            `*` for every other fault.
        package: name and version of the package that it comes from; filled in when it is loaded.
    """

    name: str
    noun: str
    sample: type[Any]
    models: tuple[DeviceModel, ...]
    actuates: bool = False
    holds: bool = False
    guards: bool = False
    aliases: tuple[str, ...] = ()
    endpoint: str = ""
    labels: tuple[str, ...] = ()
    stale_s: Callable[[Any, Any], float | None] = lambda safety, own: None
    rate_hz: Callable[[Any, float], float] = lambda own, loop_hz: loop_hz
    age_s: float = 0.1
    gap_s: float = 0.5
    delivered: float = 0.9
    own_clock: bool = False
    topics: tuple[Topic, ...] = ()
    figures: Callable[[Inputs], Iterator[tuple[str, Figures]]] = lambda inputs: iter(())
    plots: tuple[Plot, ...] = ()
    forces: Callable[[Inputs, Any, Any], Iterator[Force]] = lambda inputs, robot, own: iter(())
    witness: Witness | None = None
    look: Callable[[Any], Iterable[Finding]] | None = None
    passes: Mapping[str, str] = field(default_factory=dict, hash=False)
    package: str = "hil"

    def model(self, name: str) -> DeviceModel:
        """A model by its name; raises `KeyError`."""
        return next(m for m in self.models if m.name == name)

    @property
    def shown_as(self) -> str:
        """Its name in what `hil emulate` prints."""
        return self.endpoint or self.name


@cache
def kinds() -> Mapping[str, DeviceKind]:
    """All kinds by name, in the order in which they are opened and read: the shipped ones first.

    Raises:
        ConfigError: an installed package adds something that cannot be used.
    """
    found: dict[str, DeviceKind] = {}
    for name in KINDS:
        found[name] = importlib.import_module(f"{_OURS}.{name}").KIND
    entries = sorted(entry_points(group=GROUP), key=lambda e: (e.value, e.name))
    items = [(item, _origin(entry)) for entry in entries for item in _loaded(entry)]
    for item, origin in items:
        if isinstance(item, DeviceKind):
            add_kind(found, item, origin)
    for item, origin in items:
        if isinstance(item, DeviceModel):
            add_model(found, item, origin)
    return found


def kind_of(name: str) -> DeviceKind | None:
    """The kind of a name or alias; None where there is none."""
    return next((k for k in kinds().values() if name in (k.name, *k.aliases)), None)


def added() -> tuple[DeviceKind, ...]:
    """The kinds that installed packages add."""
    return tuple(kind for name, kind in kinds().items() if name not in KINDS)


def _origin(entry: EntryPoint) -> str:
    return "an unnamed package" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def _loaded(entry: EntryPoint) -> tuple[DeviceKind | DeviceModel, ...]:
    origin = _origin(entry)
    try:
        item = entry.load()
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"device package {origin}: {entry.value} cannot be loaded ({type(error).__name__}: {error})",
            expected="a DeviceKind or a DeviceModel of hil.vocabulary.kinds",
            remedy=f"install what it needs or a version for this hil, or uninstall {origin.split()[0]}",
        ) from error
    items = item if isinstance(item, tuple) else (item,)
    for one in items:
        if not isinstance(one, (DeviceKind, DeviceModel)):
            raise ConfigError(
                f"device package {origin}: {entry.value} is a {type(one).__name__}",
                expected="a DeviceKind or a DeviceModel of hil.vocabulary.kinds",
            )
    return items
