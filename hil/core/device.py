"""Base classes of device kinds and device models: inherit, set the attributes, override what differs.

A kind (`imu`) is what the rest of the bench knows: its samples, and how they are checked, recorded and
plotted. A model (`bno055`) is a product of that kind: its table in the bench file, its driver, and its
emulated device. `model = "..."` in the bench file selects the model. Both classes hold no state.
"""

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
    """Address at which a driver reaches an emulated device in this process.

    Attributes:
        values: address keys of its table in the bench file (`port`, `channel`, ...).
        parts: stand-ins for objects of a vendor's library: keyword arguments of the driver.
        close: function that releases the address.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, Any] = field(default_factory=dict)
    close: Callable[[], None] = lambda: None


class Found(NamedTuple):
    """A device that discovery found.

    Attributes:
        table: keys of its table in the bench file.
        notes: remarks for the user.
        parts: its components as dataclasses, for example each servo of a bus.
    """

    table: Mapping[str, Any]
    notes: tuple[str, ...] = ()
    parts: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Search:
    """Places that discovery may search besides serial ports.

    Attributes:
        given: tables of devices that the user named, by kind.
        clock: clock for timeouts.
        say: function that receives progress.
        sysfs: folder in which the kernel lists its devices.
        found: tables of what has been found so far, by kind.
    """

    given: Mapping[str, Sequence[Any]]
    clock: Clock
    say: Callable[[str], None]
    sysfs: Path
    found: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


class Topic(NamedTuple):
    """A ROS 2 topic on which a kind's samples are recorded.

    Attributes:
        name, type: topic name and message type, for example `/imu/data` and `sensor_msgs/msg/Imu`.
        message: function that makes the message from a sample and a `MessageMaker` of
            `hil.recording.rosbags_adapter`; None to send none.
    """

    name: str
    type: str
    message: Callable[[Any, Any], Any]


def by_axis(values: Array) -> Figures:
    """Figures of a vector (3,) by axis."""
    return dict(zip("xyz", values.tolist(), strict=True))


class Plot(NamedTuple):
    """A plot of the monitor: its tab, title, and the entity that `DeviceKind.figures` gives it."""

    tab: str
    title: str
    entity: str


class Force(NamedTuple):
    """A force on the robot that the monitor draws as an arrow.

    Attributes:
        name: source of the force, for example `fan`.
        place_m: (3,) point of application, body frame.
        force_n: (3,) force vector, body frame.
    """

    name: str
    place_m: Array
    force_n: Array


def import_object(path: str) -> Any:
    """Import and return the object that `package.module:name` names."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def can_open(device: Device) -> bool:
    """Whether a device can be opened; closes it again."""
    try:
        device.open()
    except HilError:
        return False
    device.close()
    return True


class DeviceModel:
    """One model within a kind. `SerialModel` and `CanModel` of `hil.drivers.serial_and_can_models` fit most.

    Attributes:
        kind: name of the kind.
        name: value of `model = "..."` in the bench file.
        title: readable name, for example `BNO055 on a serial port`.
        config: its table in the bench file, a subclass of `hil.config.device.DeviceConfig`.
        driver: `package.module:Class` of the driver, which takes (config, clock).
        chip: `package.module:Class` of the emulated device; empty where it cannot be emulated.
        emulation: `package.module:function` that makes the emulated device from (model, request) and connects
            it; empty where `chip` has a `build(request)` that does both.
        probe_order: models with a smaller number are probed first: those that answer quickly.
        probe_writes: bytes that `probe` writes to the port, in words; empty where it only listens.
        usb: (vendor, product) ids of adapters that are this model; no `probe` writes to such adapters.
        wire: connection of the real device, which decides the faults that can be injected in front of it:
            `serial`, `lines` (of text), `bus` (a serial line on which the device answers only), `can`,
            `udp`, `poses` of a library, or empty for another one.
        framing: protocol on a serial wire by its name in `hil.links.framing`; empty where whatever arrives at
            once is one message.
        not_measured: fields of the kind's sample that this model does not measure: NaN with every status.
        package: name and version of the package that provides it; set when it is loaded.
    """

    kind: ClassVar[str]
    name: ClassVar[str]
    title: ClassVar[str]
    config: ClassVar[type[Any]]
    driver: ClassVar[str]
    chip: ClassVar[str] = ""
    emulation: ClassVar[str] = ""
    probe_order: ClassVar[int] = 5
    probe_writes: ClassVar[str] = ""
    usb: ClassVar[tuple[tuple[int, int], ...]] = ()
    not_measured: ClassVar[tuple[str, ...]] = ()
    wire: ClassVar[str] = ""
    framing: ClassVar[str] = ""
    package: str = "hil"

    def make_driver(self, config: Any, clock: Clock, **parts: Any) -> Device:
        """Make the driver; it is not opened.

        Args:
            config: the device's table in the bench file.
            clock: the bench clock.
            parts: stand-ins for objects of a vendor's library (`Connection.parts`).
        """
        device: Device = import_object(self.driver)(config, clock, **parts)
        return device

    def emulate(self, request: Any) -> Any:
        """Build the emulated device for a `hil.fakes.emulated_device.EmulationRequest`; not connected."""
        if self.emulation:
            return import_object(self.emulation)(self, request)
        return import_object(self.chip).build(request)

    def wire_of(self, config: Any) -> str:
        """Connection of the real device, as `wire`, with this table of the bench file."""
        return self.wire

    def truth_options(self) -> type[Any] | None:
        """Dataclass of `[emulation.KIND]`, the true parameters of the emulated device; None without any."""
        return getattr(import_object(self.chip), "Options", None) if self.chip else None

    def probe(self, port: str, clock: Clock) -> Found | None:
        """Find this model at a serial port; None if it is not there. Changes no setting of a device."""
        return None

    def search(self, search: Search) -> Found | None:
        """Find this model on CAN, network or USB; None if it is not there. Changes no setting of a device."""
        return None

    def check(self, watched: Any) -> Iterable[Finding]:
        """Findings of `hil doctor` on a `hil.drivers.doctor_watch.Watched`, besides those of the kind."""
        return ()

    def connection(self, endpoint: Mapping[str, Any]) -> Mapping[str, Any] | Connection:
        """Address keys of its table, from the endpoint that `hil emulate` printed."""
        return {key: value for key, value in endpoint.items() if key in self.config.model_fields}

    @property
    def can_probe(self) -> bool:
        """Whether the model overrides `probe`."""
        return type(self).probe is not DeviceModel.probe

    @property
    def can_search(self) -> bool:
        """Whether the model overrides `search`."""
        return type(self).search is not DeviceModel.search


class DeviceKind:
    """Facts that the bench knows about a kind of device; the defaults describe a plain sensor.

    Attributes:
        name: names its table in the bench file, its field or key in `Inputs`, its faults and its topics.
        noun: its name in messages, for example `camera`.
        sample: dataclass of its samples: a `stamp` and a `status` (one, or one for each channel), scalars
            and arrays.
        models: available models; the first is the default where the bench file names none.
        aliases: other common names.
        labels: names of the channels, where `status` has several.
        endpoint: its name in the output of `hil emulate`, where that differs from `name`.
        moves_robot: True if it is opened last and closed first, because it moves the robot: servos only.
        holds_robot: True if its action keeps the robot on its surface (`hil.core.interfaces.Holding`): opened
            first, closed last, left alone by a stop.
        guards_hold: True if its samples show how firmly the robot is held. A run that leaves devices out
            keeps this device, as it keeps the devices that hold the robot.
        has_own_clock: True if samples carry the device's own time.
        max_age_s: largest age of its samples on arrival, at rest.
        max_gap_s: longest gap between good samples that is still healthy.
        min_delivered: smallest share of good samples.
        topics: ROS 2 topics on which its samples are recorded.
        plots: plots in which the monitor draws `figures`.
        motion_threshold: largest apparent change of `motion_value` within 0.2 s while the robot rests; 0
            where its samples do not show motion.
        measures_position: True if `motion_value` is a position in m, which gives the distance travelled.
            Where the threshold exceeds 1 mm, only a distance above the threshold counts.
        silent_faults: reason, by fault, why no check may report it: which data do not change, or that nothing
            detects it; `*` for every other fault.
        package: name and version of the package that provides it; set when it is loaded.
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
        """Time (s) without a good sample after which the device counts as silent; None for never.

        Args:
            safety: `[safety]` of the bench file.
            config: the device's table; its `stale_s` by default.
        """
        return getattr(config, "stale_s", None)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """Samples per second of a healthy device; NaN where the rate is set outside the bench file.

        Args:
            config: the device's table; its `rate_hz` by default, else the loop rate.
            loop_hz: loop rate.
        """
        return float(getattr(config, "rate_hz", loop_hz))

    def checks(self, config: Any) -> Sequence[Any]:
        """New checks (`hil.loop.cycle_data.Check`) for a run, which stop the robot by this kind's samples.

        Args:
            config: the device's table.
        """
        return ()

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Values of a cycle that the monitor plots: (entity, figures by name) for each plot."""
        yield from ()

    def forces(self, inputs: Inputs, robot: Any, config: Any) -> Iterator[Force]:
        """Forces on the robot as measured in a cycle, in place of the nominal ones of `[robot]`.

        Args:
            inputs: inputs of the cycle.
            robot: `[robot]` of the bench file.
            config: the device's table, or None.
        """
        yield from ()

    def motion_value(self, sample: Any) -> Array | None:
        """Value (k,) that changes when the robot moves; None where the sample cannot be used."""
        return None

    def check(self, watched: Any) -> Iterator[Finding]:
        """Findings of `hil doctor` on a `hil.drivers.doctor_watch.Watched`; by default on lost samples."""
        yield from watched.losses("check cable, supply and settings")

    def model(self, name: str) -> DeviceModel:
        """The model with this name. Raises `KeyError`."""
        found = next((m for m in self.models if m.name == name), None)
        if found is None:
            raise KeyError(name)
        return found

    @property
    def shown_as(self) -> str:
        """Name of the device in the output of `hil emulate`."""
        return self.endpoint or self.name
