"""The limits of a bench, and the set of its checks."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from hil.loop.checks.adhesion import AdhesionWatch
from hil.loop.checks.lifting_work import WeightCheck
from hil.loop.checks.mocap_estimate import MocapEstimate
from hil.loop.checks.motion_agreement import MotionCheck
from hil.loop.checks.out_of_plane import CameraOutOfPlane
from hil.loop.checks.sensor_rate import Healthy
from hil.loop.checks.steering_encoders import SteeringWatch
from hil.loop.checks.wheel_radius import WheelRadiusCheck
from hil.loop.checks.wheel_slip import WheelSlipCheck
from hil.loop.cycle_data import Check


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of one bench; timeouts in s, angles in rad. `heading_limit_rad` applies on a wall only.

    `stale_s` is the time without a good sample after which a kind of device counts as silent; kinds without
    an entry are not checked. `servo_ids` are the bus IDs in the order of `SERVOS`, for messages, empty when
    unknown.
    """

    stale_s: Mapping[str, float] = field(default_factory=lambda: {"servos": 0.1})
    wheel_rate_limit_rad_s: float = 4.9
    steering_limit_rad: float = 2.0944
    heading_limit_rad: float = math.radians(15.0)
    tracking_error_limit_m: float = 0.5
    body_speed_limit_m_s: float = 0.5
    adhesion_limit_m_s2: float = 5.0
    on_wall: bool = True
    servo_ids: tuple[int, ...] = ()


@dataclass(frozen=True)
class Checks:
    """Comparisons of sensors with each other, and the disagreements that stop the robot.

    If control does not use the sensor in doubt, there is only a warning: a script that turns single wheels
    follows no pose, and odometry needs no camera.

    Attributes:
        motion: camera against wheels and gyro; None without this check.
        camera: the camera's motion out of the plane; None without a camera.
        estimate: the estimate against motion capture; None without motion capture or another independent
            sensor.
        wheels: check of each wheel against the other three; None where they are not commanded by one motion.
        radii: radius of each wheel by the body's turn and the currents; None as for `wheels`.
        needs_camera: True if the estimate in the loop uses the camera: the robot stops if that is in doubt or
            silent.
        steering: external encoders against the servos; None without this check.
        stops_by_steering: True if a slipped horn stops the robot, as where a pose is followed.
        estimated: devices whose measurements the estimators use.
        holders: devices that keep the robot on its surface: noun by kind.
        healthy: expected rate and delay of the samples, by sensor.
        gap_s: longest healthy time without a good sample, by sensor.
        brought: sensors of other packages, and sample fields that they do not measure.
        hold: check of the adhesion force; None where no sensor measures it.
        lost_after_s: time without any sample, by sensor, after which a robot that follows a pose stops;
            reconnecting a sensor may take longer.
        weight: work of the drives against the weight; None off a wall.
        rests_on: keys of the bench file that scale what holds the robot, and that nothing confirms.
        added: checks of the device kinds, by kind.
        emulated: emulated devices; in real time the process that serves them may be late itself.
        served: other devices that a program of this computer serves; it may be late itself.
    """

    motion: MotionCheck | None = None
    camera: CameraOutOfPlane | None = None
    estimate: MocapEstimate | None = None
    wheels: WheelSlipCheck | None = None
    radii: WheelRadiusCheck | None = None
    needs_camera: bool = False
    steering: SteeringWatch | None = None
    stops_by_steering: bool = False
    estimated: frozenset[str] = frozenset(("tracker", "imu"))
    hold: AdhesionWatch | None = None
    holders: Mapping[str, str] = field(default_factory=dict)
    healthy: Mapping[str, Healthy] = field(default_factory=dict)
    gap_s: Mapping[str, float] = field(default_factory=dict)
    brought: Mapping[str, Collection[str]] = field(default_factory=dict)
    lost_after_s: Mapping[str, float] = field(default_factory=dict)
    weight: WeightCheck | None = None
    rests_on: tuple[str, ...] = ()
    added: Mapping[str, Sequence[Check]] = field(default_factory=dict)
    emulated: frozenset[str] = frozenset()
    served: frozenset[str] = frozenset()
