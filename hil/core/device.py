"""What a kind of device and a model of it are: inherit, state what is particular, override what differs.

A kind (`imu`) is what the rest of the bench knows: its samples, how they are judged, recorded and drawn. A
model of it (`bno055`) is a thing that one can buy: its table in the bench file, its driver, and its emulated
counterpart. `model = "..."` in the bench file chooses. Both are classes without state of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from hil.core.clock import Clock
from hil.core.errors import HilError
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.interfaces import Device
from hil.core.signals import Inputs

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


def loaded(path: str) -> Any:
    """What `package.module:name` names; imported when it is needed."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def opens(device: Device) -> bool:
    """Whether a device opens; it is closed again."""
    try:
        device.open()
    except HilError:
        return False
    device.close()
    return True


class DeviceModel:
    """One model within a kind. `SerialModel` and `CanModel` of `hil.devices.serial_and_can_models` fit most.

    Attributes:
        kind: name of the kind.
        name: as `model = "..."` in the bench file names it.
        title: as a person says it, for example `BNO055 on a serial port`.
        config: its table in the bench file, a subclass of `hil.config.device.DeviceConfig`.
        driver: `package.module:Class` of the driver, which takes (config, clock).
        chip: `package.module:Class` of the emulated device; empty where it cannot be emulated.
        probe_order: models with a smaller number are asked first: those that answer quickly.
        probe_writes: what `probe` writes to the port, in words; empty where it only listens.
        usb: (vendor, product) ids of adapters that are this model: `probe` of no model writes to them.
        not_measured: fields of the kind's sample that this model does not measure: NaN with every status.
        package: name and version of the package that it comes from; filled in when it is loaded.
    """

    kind: ClassVar[str]
    name: ClassVar[str]
    title: ClassVar[str]
    config: ClassVar[type[Any]]
    driver: ClassVar[str]
    chip: ClassVar[str] = ""
    probe_order: ClassVar[int] = 5
    probe_writes: ClassVar[str] = ""
    usb: ClassVar[tuple[tuple[int, int], ...]] = ()
    not_measured: ClassVar[tuple[str, ...]] = ()
    package: str = "hil"

    def make_driver(self, config: Any, clock: Clock, **parts: Any) -> Device:
        """The driver, closed.

        Args:
            config: the table of the device.
            clock: the bench clock.
            parts: stand-ins for objects of a vendor's library (`Connection.parts`).
        """
        device: Device = loaded(self.driver)(config, clock, **parts)
        return device

    def emulate(self, request: Any) -> Any:
        """The emulated device of a `hil.devices.emulated_device.EmulationRequest`, not connected."""
        return loaded(self.chip).build(request)

    def truth_options(self) -> type[Any] | None:
        """Dataclass of `[emulation.KIND]`, what is true of the emulated one; None where there is nothing."""
        return getattr(loaded(self.chip), "Options", None) if self.chip else None

    def probe(self, port: str, clock: Clock) -> Found | None:
        """The model at a serial port, if it is there. It changes no setting of a device."""
        return None

    def search(self, search: Search) -> Found | None:
        """The model elsewhere (CAN, network, USB), if it is there. It changes no setting of a device."""
        return None

    def check(self, watched: Any) -> Iterable[Finding]:
        """Findings of `hil doctor` beside those of the kind, of a `hil.devices.doctor_watch.Watched`."""
        return ()

    def connection(self, endpoint: Mapping[str, Any]) -> Mapping[str, Any] | Connection:
        """Keys of its table from the endpoint that `hil emulate` printed."""
        return {key: value for key, value in endpoint.items() if key in self.config.model_fields}

    @property
    def can_probe(self) -> bool:
        """Whether `probe` is more than the default."""
        return type(self).probe is not DeviceModel.probe

    @property
    def can_search(self) -> bool:
        """Whether `search` is more than the default."""
        return type(self).search is not DeviceModel.search


class DeviceKind:
    """What the bench knows of a kind of device; every default is that of a plain sensor.

    Attributes:
        name: of its table in the bench file, its field or key in `Inputs`, its faults and its topics.
        noun: as sentences call it: `camera`.
        sample: dataclass of its samples: a `stamp` and a `status` (one, or one for each channel), scalars
            and arrays.
        models: what there is of it; the first is meant where the bench file names none.
        aliases: further names that people give it.
        labels: names of the channels, where `status` has several.
        endpoint: its name in what `hil emulate` prints, where that is not its own.
        moves_robot: whether it is opened last and closed first, because it moves the robot: servos only.
        holds_robot: whether what it does keeps the robot on its surface
            (`hil.core.interfaces.Holding`): opened first, closed last, left alone by a stop.
        guards_hold: whether its samples show how firmly the robot is held: a run that leaves devices out
            keeps it, as it keeps those that hold.
        has_own_clock: whether samples carry the device's own time.
        max_age_s: how old its samples may be when they arrive, at rest.
        max_gap_s: longest gap between good samples that is still healthy.
        min_delivered: least share of the samples that have to be good.
        topics: where its samples are recorded.
        plots: where the monitor draws `figures`.
        motion_threshold: by how much `motion_value` may seem to change within 0.2 s while the robot rests; 0
            where its samples do not show motion.
        measures_position: whether `motion_value` is a position in m, which says how far the robot went; where
            the threshold is more than a millimetre, only a way of more than that.
        silent_faults: by fault, why it may pass without a word: which data do not change, or that nothing
            notices; `*` for every other fault.
        package: name and version of the package that it comes from; filled in when it is loaded.
    """

    name: ClassVar[str]
    noun: ClassVar[str]
    sample: ClassVar[type[Any]]
    models: tuple[DeviceModel, ...]
    aliases: ClassVar[tuple[str, ...]] = ()
    labels: ClassVar[tuple[str, ...]] = ()
    endpoint: ClassVar[str] = ""
    moves_robot: ClassVar[bool] = False
    holds_robot: ClassVar[bool] = False
    guards_hold: ClassVar[bool] = False
    has_own_clock: ClassVar[bool] = False
    max_age_s: ClassVar[float] = 0.1
    max_gap_s: ClassVar[float] = 0.5
    min_delivered: ClassVar[float] = 0.9
    topics: ClassVar[tuple[Topic, ...]] = ()
    plots: ClassVar[tuple[Plot, ...]] = ()
    motion_threshold: ClassVar[float] = 0.0
    measures_position: ClassVar[bool] = False
    silent_faults: ClassVar[Mapping[str, str]] = {}
    package: str = "hil"

    def stale_after_s(self, safety: Any, config: Any) -> float | None:
        """Time without a good sample after which it counts as silent; None for never.

        Args:
            safety: `[safety]` of the bench file.
            config: table of the device; its `stale_s` by default.
        """
        return getattr(config, "stale_s", None)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """Samples per second of a healthy device; NaN where its owner chooses.

        Args:
            config: table of the device; its `rate_hz` by default, else the loop rate.
            loop_hz: loop rate.
        """
        return float(getattr(config, "rate_hz", loop_hz))

    def checks(self, config: Any) -> Sequence[Any]:
        """Checks that stop the robot by its samples: `hil.loop.cycle_data.Check`, new ones for each run.

        Args:
            config: table of the device.
        """
        return ()

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """What the monitor draws of a cycle: (entity, figures by name) for each plot."""
        yield from ()

    def forces(self, inputs: Inputs, robot: Any, config: Any) -> Iterator[Force]:
        """Forces on the robot by a cycle's samples, instead of those that `[robot]` promises.

        Args:
            inputs: of the cycle.
            robot: `[robot]` of the bench file.
            config: table of the device, or None.
        """
        yield from ()

    def motion_value(self, sample: Any) -> Array | None:
        """(k,) that changes when the robot moves; None where the sample cannot be used."""
        return None

    def check(self, watched: Any) -> Iterator[Finding]:
        """Findings of `hil doctor`, of a `hil.devices.doctor_watch.Watched`: good samples by default."""
        yield from watched.losses("check cable, supply and settings")

    def model(self, name: str) -> DeviceModel:
        """A model by its name; raises `KeyError`."""
        found = next((m for m in self.models if m.name == name), None)
        if found is None:
            raise KeyError(name)
        return found

    @property
    def shown_as(self) -> str:
        """Name of the device in the output of `hil emulate`."""
        return self.endpoint or self.name
