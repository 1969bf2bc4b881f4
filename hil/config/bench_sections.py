"""Sections of `bench.toml` that belong to no device: loop, safety, alignment, emulation, record, exit."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator

from hil.config.assumed_parameters import Parameter, each, plus
from hil.config.field_types import HeadingLimit, Signs, SteeringZero, Strict, Switch, WheelRate, Within

Silence = Annotated[float, Within(0.01, 10.0, "after a longer silence it is too late to stop the robot")]


class LoopConfig(Strict):
    """Rate and real-time behaviour of the control loop.

    Attributes:
        rate_hz: cycles per second.
        late_after_s: delay beyond its deadline from which on the start of a cycle counts as late.
        fifo_priority: priority under SCHED_FIFO, where the system allows it; none leaves the scheduler alone.
        cpu: number of the core that the loop is bound to; none leaves it to the system.
    """

    rate_hz: Annotated[float, Within(1.0, 1000.0, "cycles per second")] = 100.0
    late_after_s: Annotated[float, Within(1e-6, 1.0, "later than a second is no cycle")] = 0.001
    fifo_priority: Annotated[int, Within(1, 99, "SCHED_FIFO has these")] | None = None
    cpu: Annotated[int, Within(0, 1023, "Linux numbers no more cores")] | None = None


class SafetyConfig(Strict):
    """Limits at which the supervisor stops the robot.

    Attributes:
        servo_stale_s, imu_stale_s, tracker_stale_s: age after which a device counts as silent.
        wheel_rate_limit_rad_s, steering_limit_rad: setpoints are clipped to these.
        heading_limit_rad: largest heading on a wall; beyond it the thrust no longer points up. At most the
            heading at which `[robot]` still holds on the most slippery surface known, unless `tethered`.
        tethered: true where the robot is on a tether and cannot fall: for finding the heading at which it
            slides.
        tracking_error_limit_m: distance from the reference.
        body_speed_limit_m_s: speed that the camera may see: faster is a slide.
        adhesion_limit_m_s2: specific force below which the robot counts as falling; at least 1 on a wall.
        adhesion_reserve: share by which, with a fan among the devices, its measured force exceeds what holds
            the robot; below that no wheel moves.
        adhesion_stale_s: age after which fan, load cells or propellers that report count as silent; the robot
            then stops.
        utilisation_limit: share of its friction that no wheel may exceed.
    """

    servo_stale_s: Annotated[float, Within(0.01, 2.0, "wheels go on turning meanwhile")] = 0.1
    imu_stale_s: Silence = 0.5
    tracker_stale_s: Silence = 2.0
    wheel_rate_limit_rad_s: WheelRate = 4.9
    steering_limit_rad: Annotated[float, Within(0.01, 3.1416, "setpoints lie within half a turn")] = 2.0944
    heading_limit_rad: HeadingLimit = 0.2618
    tethered: Switch = False
    tracking_error_limit_m: Annotated[float, Within(0.001, 1.0, "a robot 1 m off is lost")] = 0.5
    body_speed_limit_m_s: Annotated[
        float, Within(0.05, 1.0, "the robot drives 0.13 m/s; 1 m/s is a fall of 5 cm")
    ] = 0.5
    adhesion_limit_m_s2: Annotated[float, Within(0.0, 9.0, "standing feels 9.8, falling nothing")] = 5.0
    adhesion_reserve: Annotated[
        float, Within(0.1, 3.0, "a tenth is what measuring and drawing leave open")
    ] = 0.25
    adhesion_stale_s: Annotated[float, Within(0.05, 2.0, "a fan that stops lets the robot fall in 0.3 s")] = (
        0.25
    )
    utilisation_limit: Annotated[float, Within(0.1, 0.95, "at 1 the wheel slides")] = 0.8


class AlignmentConfig(Strict):
    """Signs and zeros between servo angles and body angles, wheel order FL, BL, BR, FR.

    Attributes:
        drive_sign, steer_sign: sign of each servo: 1, or -1 where the servo is mounted the other way round.
        steer_zero_rad: servo angle at which the wheel points along body x (`hil run steering_zero` finds it).
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("drive_sign", (each(-1, 1, 1, 1), each(-1, -1, -1, -1)), ("mocap", "tracker")),
        Parameter("steer_sign", (each(1, -1, 1, 1), each(-1, -1, -1, -1)), ("encoders",)),
        Parameter("steer_zero_rad", (plus(0.2), plus(0.1, 0.1, 0.1, 0.1), plus(0.0, 1.0)), ("encoders",)),
    )

    drive_sign: Signs = (1, 1, 1, 1)
    steer_sign: Signs = (1, 1, 1, 1)
    steer_zero_rad: tuple[SteeringZero, SteeringZero, SteeringZero, SteeringZero] = (0.0, 0.0, 0.0, 0.0)


class EmulationConfig(Strict):
    """The emulated world: only read when at least one device is emulated.

    Every kind of device has a table of its own beside these: true imperfections of the emulated device, and
    the true value of any key of the device's table that is wrong in the bench file.

    Attributes:
        plant: the physics of body, wheels and surface: `own`, or `mujoco` (extra `mujoco`), an engine that
            others wrote. Both have the same motors, servos and seeds.
        contact: contact law of the wheels, for `mujoco` only. `creep`: loaded wheels lose a share of every
            metre, as tyres do; that is taken where it is left out. `holding`: they hold until they slide (dry
            friction).
        mjcf: MJCF file of your own robot, for `mujoco` only, with joints `steer_FL` ... `drive_FR`; made from
            `[robot]` where it is left out.
        faults: specs (`imu:stuck@2+3`) or paths of TOML timelines.
        randomise_truth: true to draw the robot's true parameters by seed instead of taking the nominal ones.
        geometry_share: share of the drawn deviations of wheel positions, radii and steering zeros; 1 is the
            robot as delivered, less is what a calibration would have left of them.
        replay: recording (of this project, a public pair, or plain CSV) whose motion the robot repeats,
            whatever it is commanded; without it the robot is simulated.
        replay_after_s: world time at which that motion begins; before it the robot stands.
        environment, robot: true values of keys of these tables that are wrong in the bench file.
    """

    plant: Literal["own", "mujoco"] = "own"
    contact: Literal["creep", "holding"] | None = None
    mjcf: str | None = None
    randomise_truth: Switch = True
    geometry_share: Annotated[float, Within(0.0, 1.0, "a share of what is drawn")] = 1.0
    faults: tuple[str, ...] = ()
    replay: str | None = None
    replay_after_s: Annotated[float, Within(0.0, 3600.0, "s of the world")] = 4.0
    environment: dict[str, Any] = Field(default_factory=dict)
    robot: dict[str, Any] = Field(default_factory=dict)


class FaultsConfig(Strict):
    """What may be injected in front of real devices, if the command line asks for it, too.

    Attributes:
        real: most dangerous place of the robot at which faults may be injected: `none`, `floor`, `tethered`
            (on a wall, on a tether), `wall` (without one).
        devices: names of the real devices whose messages may be damaged, delayed or withheld.
    """

    real: Literal["none", "floor", "tethered", "wall"] = "none"
    devices: tuple[str, ...] = ()


class RecordConfig(Strict):
    """The record of the robot, in which procedures keep what they find out.

    Attributes:
        folder: path of the record; need not exist yet. What is in it counts instead of what the bench file
            says, and a procedure that passed adds its part.
        without: parts of it that are not to be applied.
        valid_days: validity of a part that is added; unlimited without it.
    """

    folder: str | None = None
    without: tuple[str, ...] = ()
    valid_days: Annotated[int, Within(1, 36_500, "a hundred years")] | None = None

    @field_validator("without", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        """Names separated by commas, as an option gives them."""
        return tuple(filter(None, value.split(","))) if isinstance(value, str) else value


class ExitConfig(Strict):
    """Treatment of the robot when the work ends.

    Attributes:
        policy: `hold` keeps torque on, `release` drops it: on a wall the robot then slides.
        look_after_s: time for which a bench that closes keeps monitoring a robot that is not held yet. With
            propellers that report nothing, one check takes as long as they would need to let the robot slide:
            6 s for the robot of the shipped profile.
    """

    policy: Literal["hold", "release"] = "hold"
    look_after_s: Annotated[float, Within(1.0, 3600.0, "s; a look takes up to 0.6 s")] = 5.0
