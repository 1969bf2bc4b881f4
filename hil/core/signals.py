"""Data types of the loop: samples, states, references, setpoints, cycle records.

Frozen dataclasses, SI units, unit and frame in the name. Wheel order is FL, BL, BR, FR everywhere
(the paper's 1..4); an array over servos has the four drives first, then the four steers, each in
wheel order. "No data" is never a number: it is NaN together with a status that says why.

Frames: `body` has x forward, y left, z out of the surface; `wall` has X up the wall, Y to the left,
Z out of the wall (arXiv 2509.04016). On the floor the same names hold with Z up.
"""

import enum
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from hil.core.errors import UsageError
from hil.core.external_commands import ExternalCommands
from hil.core.geometry import Array
from hil.core.known_names import KINDS as KINDS
from hil.core.stop_suspects import SEPARATOR

WHEELS = ("FL", "BL", "BR", "FR")
DRIVES, STEERS = tuple(f"drive_{w}" for w in WHEELS), tuple(f"steer_{w}" for w in WHEELS)
SERVOS = DRIVES + STEERS


class Status(str, enum.Enum):
    """Reason why a sample or a channel of it can or cannot be used."""

    OK = "ok"
    TIMEOUT = "timeout"
    CRC = "crc"
    HARDWARE_ERROR = "hardware error"
    PROTOCOL = "protocol"
    STALE = "stale"
    FROZEN = "frozen"
    STARTING = "starting"
    NOT_TRACKED = "not tracked"
    LOW_CONFIDENCE = "low confidence"
    JUMP = "jump"
    NOT_FINITE = "not finite"
    IMPLAUSIBLE = "implausible"
    PARITY = "parity"
    MAGNET = "magnet"
    RESET = "reset"


_OK = Status.OK
_ALL_OK = (_OK,) * len(SERVOS)


@dataclass(frozen=True)
class Stamp:
    """Times at which a sample was measured and at which the host received it.

    Attributes:
        t_ns: best estimate of the time of measurement, on the bench clock.
        host_ns: time at which the host received it, on the bench clock.
        seq: sequence number counted by the source (or the driver), never decreasing.
        device_ns: the device's own clock where it has one, else None.
    """

    t_ns: int
    host_ns: int
    seq: int
    device_ns: int | None = None


@dataclass(frozen=True)
class ServoSample:
    """One synchronised read of the eight servos; arrays of shape (8,), order `SERVOS`.

    Angles are the servo's own (before `alignment`), multi-turn; NaN where `status` is not OK.
    `current_a` is signed motor current. `alert` is the hardware-error byte per servo (0 = none).
    """

    stamp: Stamp
    position_rad: Array
    velocity_rad_s: Array
    current_a: Array
    status: tuple[Status, ...]
    alert: tuple[int, ...] = (0,) * len(SERVOS)

    @property
    def ok(self) -> bool:
        """Whether all eight servos answered."""
        return self.status == _ALL_OK

    @property
    def drive_rad(self) -> Array:
        """Angles (4,) of the drives, rad, in the order of `DRIVES`."""
        return self.position_rad[: len(DRIVES)]

    @property
    def steer_rad(self) -> Array:
        """Angles (4,) of the steering axes, rad, in the order of `STEERS`."""
        return self.position_rad[len(DRIVES) :]

    @property
    def drive_rad_s(self) -> Array:
        """Rates (4,) of the drives, rad/s, in the order of `DRIVES`."""
        return self.velocity_rad_s[: len(DRIVES)]


@dataclass(frozen=True)
class ServoHealth:
    """Slowly changing state of the eight servos, in the order of `SERVOS`.

    Most cycles have none: there is one per `servos.health_period_s` (s; by default every second), and one
    more when goals begin to be clipped.

    Attributes:
        stamp: times of the read.
        voltage_v: (8,) V, NaN where a servo did not answer.
        temperature_c: (8,) degrees Celsius, NaN where a servo did not answer.
        status: status of each servo.
        clipped: number of goals, by servo, clipped to limits of bench or servo since the last such sample.
    """

    stamp: Stamp
    voltage_v: Array
    temperature_c: Array
    status: tuple[Status, ...]
    clipped: tuple[int, ...] = (0,) * len(SERVOS)


@dataclass(frozen=True)
class ServoHold:
    """Status of the servos for holding the robot, from the last `look_after`.

    Attributes:
        t_ns: time of that status.
        position_rad: angles (8,), as in `ServoSample`; NaN where a servo did not answer.
        trouble: reason why a servo does not hold, by its name in `SERVOS`; empty when all eight have torque
            and an armed watchdog.
        wanted: True while they are commanded to hold: from `enable` until `release`.
        late: description of servos that answer too late for a cycle, by name.
        released: True if torque was on and `release` has switched it off; `enable` does not change it.
    """

    t_ns: int
    position_rad: Array
    wanted: bool
    trouble: Mapping[str, str] = field(default_factory=dict)
    late: Mapping[str, str] = field(default_factory=dict)
    released: bool = False


@dataclass(frozen=True)
class EncoderSample:
    """External steering encoders (AS5045), shape (4,), rad in [-pi, pi), NaN where not OK."""

    stamp: Stamp
    angle_rad: Array
    status: tuple[Status, ...]
    raw_word: tuple[int, ...]


@dataclass(frozen=True)
class ImuSample:
    """Rates, gravity and attitude of an inertial unit, in the sensor's own frame.

    Attributes:
        quaternion_wxyz: shape (4,), sensor in its gravity-levelled reference frame. Without magnetometer, the
            heading is relative to that of the sensor when it was switched on or reset.
        gyro_rad_s: shape (3,).
        linear_acceleration_m_s2: shape (3,), without gravity.
        gravity_m_s2: shape (3,), points **up** (specific force at rest), sensor frame.
        calibration: (system, gyro, accelerometer, magnetometer), each 0..3, if the sensor reports it; else
            empty.
    """

    stamp: Stamp
    quaternion_wxyz: Array
    gyro_rad_s: Array
    linear_acceleration_m_s2: Array
    gravity_m_s2: Array
    calibration: tuple[int, ...]
    status: Status = Status.OK

    @property
    def specific_force_m_s2(self) -> Array:
        """Specific force, shape (3,), m/s^2: upward gravity plus linear acceleration."""
        return self.gravity_m_s2 + self.linear_acceleration_m_s2


@dataclass(frozen=True)
class TrackerSample:
    """Pose of a tracking camera in robot axes (x forward, y left, z up of the camera), in its start frame.

    The mount on the robot is not applied here; `hil.loop.alignment` does that.
    """

    stamp: Stamp
    position_m: Array
    quaternion_wxyz: Array
    velocity_m_s: Array
    angular_velocity_rad_s: Array
    confidence: int
    status: Status = Status.OK


@dataclass(frozen=True)
class MocapSample:
    """Motion-capture pose of the robot's rigid body in the capture frame."""

    stamp: Stamp
    position_m: Array
    quaternion_wxyz: Array
    tracking_valid: bool
    latency_s: float
    marker_error_m: float
    status: Status = Status.OK


@dataclass(frozen=True)
class AdhesionSample:
    """Report of the fan's controller; NaN for values that are not reported yet, or no longer.

    Attributes:
        speed_rpm: mechanical speed of the fan.
        duty: motor voltage as a share of the battery voltage, -1..1; the commanded one of a controller that
            reports none.
        motor_a, input_a: motor current and battery current.
        input_v: battery voltage at the controller.
        fet_c, motor_c: temperatures of power stage and motor.
        trouble: problem with keeping the fan running, as a text; empty for none.
    """

    stamp: Stamp
    speed_rpm: float
    duty: float
    motor_a: float
    input_a: float
    input_v: float
    fet_c: float
    motor_c: float
    status: Status = Status.OK
    trouble: str = ""


@dataclass(frozen=True)
class ThrustSample:
    """The propellers that carry part of the weight.

    Attributes:
        throttle: 0..1; the force is proportional to its square. The last value sent, NaN where this program
            has sent none; where controllers report their speed, the share of full speed.
        speed_rpm: mean speed that the controllers report; else NaN.
        trouble: contradiction between the controllers' measurements, as a text; empty for none.
    """

    stamp: Stamp
    throttle: float
    speed_rpm: float
    status: Status = Status.OK
    trouble: str = ""


@dataclass(frozen=True)
class LoadCellSample:
    """Load cells that measure the pressing force of the fan; shape (2,), N, NaN where not OK.

    Each cell has a zero offset, which `hil.loop.checks.adhesion` subtracts. `raw` holds the counts of the
    converter.
    """

    stamp: Stamp
    force_n: Array
    status: tuple[Status, ...]
    raw: tuple[int, ...]


@dataclass(frozen=True)
class Inputs:
    """Everything that the devices delivered since the previous cycle, oldest first per device.

    The fields after `health` and `servos` are the kinds of devices that this package knows, by their names
    (`KINDS`). `added` holds the samples of kinds that other packages add, by kind (`hil.core.registry`),
    and those of further devices of a kind, by the device's name. `slow_ns` holds the time that devices took
    to be read, where that was more than 10 ms. `lost_ns` holds the time that this computer took since the
    previous cycle from the loop's thread (`loop`) and from the process that emulates devices (`emulator`).
    """

    cycle: int
    t_ns: int
    servos: tuple[ServoSample, ...] = ()
    health: tuple[ServoHealth, ...] = ()
    encoders: tuple[EncoderSample, ...] = ()
    imu: tuple[ImuSample, ...] = ()
    tracker: tuple[TrackerSample, ...] = ()
    mocap: tuple[MocapSample, ...] = ()
    adhesion: tuple[AdhesionSample, ...] = ()
    thrust: tuple[ThrustSample, ...] = ()
    load_cells: tuple[LoadCellSample, ...] = ()
    added: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    slow_ns: Mapping[str, int] = field(default_factory=dict)
    lost_ns: Mapping[str, int] = field(default_factory=dict)

    def of(self, kind: str) -> tuple[Any, ...]:
        """Samples of a kind by its name; empty where it delivered nothing.

        Raises:
            UsageError: `kind` is a field that is not a kind, such as `health`.
        """
        if kind in _KNOWN:
            samples: tuple[Any, ...] = getattr(self, kind)
            return samples
        _must_be_no_field(kind)
        return self.added.get(kind, ())


def worst(sample: Any) -> Status:
    """OK where all channels of a sample can be used, else the first other status."""
    status: Status | tuple[Status, ...] = sample.status
    if not isinstance(status, tuple):
        return status
    if status.count(_OK) == len(status):
        return _OK
    return next(state for state in status if state is not _OK)


NO_KINDS = ("cycle", "t_ns", "health", "added", "slow_ns", "lost_ns")
"""Fields of `Inputs` that are not device kinds; reserved as names of kinds."""
_KNOWN = frozenset(KINDS)


def _must_be_no_field(kind: str) -> None:
    """Refuse a field of `Inputs` as the name of a kind: it would never deliver samples."""
    if kind in NO_KINDS:
        raise UsageError(f"{kind} is no kind of devices", remedy=f"read it as `inputs.{kind}`")


def samples_of(kind: str) -> Callable[[Inputs], tuple[Any, ...]]:
    """A function that gets the samples of a kind from inputs: a fast `Inputs.of` for use in every cycle.

    Raises:
        UsageError: `kind` is a field that is not a kind, such as `health`.
    """
    if kind in _KNOWN:
        return attrgetter(kind)
    _must_be_no_field(kind)
    return lambda inputs: inputs.added.get(kind, ())


@dataclass(frozen=True)
class WheelMeasurement:
    """Aligned wheel state: shape (4,) each, wheel order; signs and zero offsets applied.

    `valid` marks wheels whose drive and steer are both usable.
    """

    stamp: Stamp
    wheel_angle_rad: Array
    wheel_rate_rad_s: Array
    steering_rad: Array
    valid: tuple[bool, ...]


@dataclass(frozen=True)
class GyroMeasurement:
    """Aligned inertial sample in body axes.

    Attributes:
        yaw_rate_rad_s: rate about the surface normal.
        gravity_heading_rad: heading about the wall normal from gravity in the wall plane; NaN on the floor.
        acceleration_m_s2: (2,) body, without gravity.
    """

    stamp: Stamp
    yaw_rate_rad_s: float
    gravity_heading_rad: float
    acceleration_m_s2: Array


@dataclass(frozen=True)
class PoseMeasurement:
    """Planar pose of the body from a camera or the capture system, shape (3,): (m, m, rad unwrapped).

    `source` is `tracker` (own start frame) or `mocap` (wall frame). `quality` is 0..3.
    """

    stamp: Stamp
    source: str
    pose: Array
    quality: int
    valid: bool


@dataclass(frozen=True)
class Measurements:
    """Aligned inputs of one cycle: what the estimator sees.

    Attributes:
        added: `Inputs.added` unchanged, for user-supplied estimators. A recording stores it once.
    """

    cycle: int
    t_ns: int
    wheels: tuple[WheelMeasurement, ...] = ()
    gyro: tuple[GyroMeasurement, ...] = ()
    tracker: tuple[PoseMeasurement, ...] = ()
    mocap: tuple[PoseMeasurement, ...] = ()
    added: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)


def sensors_with_samples(cycles: Iterable[Measurements]) -> tuple[str, ...]:
    """Names of the fields of `Measurements` (sensors) with at least one sample."""
    missing = ["wheels", "gyro", "tracker", "mocap"]
    found = dict.fromkeys(missing, False)
    for m in cycles:
        for name in [n for n in missing if getattr(m, n)]:
            found[name] = True
            missing.remove(name)
        if not missing:
            break
    return tuple(name for name, there in found.items() if there)


@dataclass(frozen=True)
class RobotState:
    """Estimated state.

    Attributes:
        pose_body_in_wall: shape (3,), (x m, y m, theta rad unwrapped).
        twist_body: shape (3,), (m/s, m/s, rad/s).
        covariance: shape (6, 6) of (pose, twist), pose errors in wall axes.
        diagnostics: scalar figures by name (`nis_wheels`, `rejected_tracker`, `sag_m_s`, ...), the
            estimator's and those of checks (`adhesion_n`). In the record of a stop, which has no estimate,
            those of checks alone.
    """

    t_ns: int
    pose_body_in_wall: Array
    twist_body: Array
    covariance: Array
    diagnostics: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Reference:
    """Reference of the robot at `t_s`: pose in the wall frame, body twist, acceleration in wall axes."""

    t_s: float
    pose_in_wall: Array
    twist_body: Array
    acceleration_wall: Array
    done: bool = False


@dataclass(frozen=True)
class WheelSetpoint:
    """Wheel rates and steering angles in the aligned (body) convention, shape (4,) each."""

    wheel_rate_rad_s: Array
    steering_rad: Array


@dataclass(frozen=True)
class ServoSetpoint:
    """Goals sent on the bus: drive velocities and steering positions in the servos' own convention."""

    drive_velocity_rad_s: Array
    steer_position_rad: Array


@dataclass(frozen=True)
class Event:
    """A reported event: a fault, a rejected sample, a stop, a mode change.

    `source` is the kind of the device concerned. Where one of several kinds may be the cause, it lists them
    all (`hil.core.stop_suspects`).

    Attributes:
        distrusts: True if the samples of the source count for nothing from now on, in this run.
        key: keys of the bench file that the event contradicts, separated by commas; empty for none.
        factor: factor by which a contradicted value would fit; 0 where no factor would.
    """

    t_ns: int
    level: str
    source: str
    message: str
    distrusts: bool = False
    key: str = ""
    factor: float = 0.0

    @property
    def suspects(self) -> tuple[str, ...]:
        """Kinds of devices that the event concerns."""
        return tuple(self.source.split(SEPARATOR))


@dataclass(frozen=True)
class CycleRecord:
    """Everything about one cycle; what sinks receive and what `hil replay --verify` reproduces.

    `inputs` hold all samples, `measurements` only those of devices that the checks have not left out.

    `observers` holds the states of estimators that run beside the one in the loop, by name. `truth` is the
    true state of an emulated robot whose world runs in this process: `t_ns`, `pose_body_in_wall` (3,),
    `steering_true_rad` (4,), `normal_load_n` (4,), `slip_m_s` (4, 2) along and across each wheel, `fallen`.
    `external` holds the commands of a controller in another program; None without one.
    """

    cycle: int
    deadline_ns: int
    start_ns: int
    inputs: Inputs
    measurements: Measurements
    state: RobotState
    reference: Reference | None
    setpoint: WheelSetpoint
    command: ServoSetpoint
    events: tuple[Event, ...] = ()
    observers: Mapping[str, RobotState] = field(default_factory=dict)
    timing_ns: Mapping[str, int] = field(default_factory=dict)
    truth: Mapping[str, Any] | None = None
    external: ExternalCommands | None = None
