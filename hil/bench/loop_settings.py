"""Turns a configuration into the settings of the loop: limits, mounts, geometry, scheduling."""

import logging
import math
from dataclasses import fields

import numpy as np

from hil.bench.device_set_from_config import model_of, served_here
from hil.bench.doctor.steering_offsets import expected_offsets_rad
from hil.bench.third_party.added_checks import added_checks
from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.can_motor import DaemonMotorConfig
from hil.config.device import ImuConfig, TrackerConfig
from hil.config.encoders import EncodersConfig
from hil.config.load_cells import LoadCellsConfig
from hil.config.mocap import MocapConfig
from hil.config.servo_models import DEFAULT_MODEL, servo_model
from hil.config.servos import ServosConfig
from hil.config.thrust import ThrustConfig
from hil.core.clock import Clock, MonotonicClock
from hil.core.geometry import Array
from hil.core.registry import kinds
from hil.core.third_party_errors import OURS, call_in_package
from hil.datasets.nominal_robot import Nominal
from hil.loop.alignment import AlignmentParameters
from hil.loop.checks.adhesion import AdhesionWatch
from hil.loop.checks.adhesion_limits import AdhesionLimits
from hil.loop.checks.lifting_work import Lifted, WeightCheck
from hil.loop.checks.mocap_agreement import MocapTolerances
from hil.loop.checks.mocap_estimate import MocapEstimate
from hil.loop.checks.motion_agreement import MotionCheck
from hil.loop.checks.out_of_plane import CameraOutOfPlane
from hil.loop.checks.sensor_rate import Healthy
from hil.loop.checks.steering_encoders import SteeringWatch
from hil.loop.checks.wheel_slip import WheelSlipCheck
from hil.loop.pose_alignment import Mount
from hil.loop.realtime import RealTime
from hil.loop.safety_limits import Checks, SafetyLimits
from hil.robot.kinematics import WheelGeometry
from hil.robot.motion_limits import MotionLimits

LOG = logging.getLogger(__name__)

_LONGER_THAN_DRIVER_S = 0.1
_WHEEL_MODELS = {"exact": "equations"}
_SIGMAS, _SESSION_SCALE = 4.0, 0.01
"""Limit for good sensors, in standard deviations; difference of a scale between sessions."""
_CYCLES_LATE = 2.0
_LEAST_ALONG = 0.5
"""Share of gravity along the surface from which the drives' work shows the weight."""
_LEAST_FORCE, _HALVINGS = 0.96, 12
"""Share of its set-point that a fan surely makes: 2 % by its own speed, 2 % by the load cells."""
_SUPERVISED = {f.name for f in fields(SafetyLimits)}


def real_time(config: BenchConfig, clock: Clock) -> RealTime | None:
    """Real-time scheduling on the host's clock; None in virtual time, which waits for every computation."""
    if not isinstance(clock, MonotonicClock):
        return None
    return RealTime(clock, fifo_priority=config.loop.fifo_priority, cpu=config.loop.cpu)


def motion_limits(config: BenchConfig) -> MotionLimits:
    """Motion limits that references must respect."""
    control, safety = config.control, config.safety
    heading_limit_rad = min(control.heading_limit_rad, safety.heading_limit_rad)
    return MotionLimits(
        wheel_speed_m_s=control.wheel_speed_m_s,
        wheel_acceleration_m_s2=control.acceleration_m_s2,
        heading_limit_rad=heading_limit_rad if config.environment.on_wall else None,
        friction_rad=_by_friction(config, heading_limit_rad),
        x_range_m=config.environment.x_range_m,
        y_range_m=config.environment.y_range_m,
    )


def _by_friction(config: BenchConfig, limit_rad: float) -> tuple[float, float] | None:
    """Headings between which no wheel uses more friction than the supervisor allows; None for no bound."""
    limits = adhesion_limits(config)
    if limits is None or not config.environment.on_wall or config.safety.tethered:
        return None
    force_n, thrust_n = _LEAST_FORCE * force_wanted_n(config), thrust_wanted_n(config)

    def used(heading_rad: float) -> float:
        return max(limits.statics.utilisation(force_n, thrust_n, heading_rad))

    if used(0.0) > limits.utilisation:  # told before the robot moves, with the force that is measured
        return None
    sides = []
    for inside, outside in ((0.0, -limit_rad), (0.0, limit_rad)):
        if used(outside) <= limits.utilisation:
            sides.append(outside)
            continue
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if used(middle) <= limits.utilisation else (inside, middle)
        sides.append(inside)
    return sides[0], sides[1]


def safety_limits(config: BenchConfig) -> SafetyLimits:
    """Limits that the supervisor enforces."""
    values = {key: value for key, value in config.safety.model_dump().items() if key in _SUPERVISED}
    servos = config.of(ServosConfig)
    limits_s: dict[str, float | None] = {}
    for name, own in config.devices().items():
        kind = kinds()[name]
        limits_s[name] = call_in_package(
            name, kind.package, "stale_after_s", kind.stale_after_s, config.safety, own
        )
    return SafetyLimits(
        **values,
        stale_s={name: limit_s for name, limit_s in limits_s.items() if limit_s is not None},
        on_wall=config.environment.on_wall,
        servo_ids=() if servos is None else servos.ids,
    )


def checks(config: BenchConfig, geometry: WheelGeometry, *, follows: bool, feedback: str) -> Checks:
    """Configure the checks that compare sensors with each other.

    Args:
        config: the bench configuration.
        geometry: wheels in use.
        follows: True if a reference is followed.
        feedback: estimator in the loop.
    """
    servos, encoders = config.of(ServosConfig), config.of(EncodersConfig)
    ids, steer_ids = ((), ()) if servos is None else (servos.ids, servos.steer_ids)
    motion = None if servos is None else motion_check(config, geometry)
    slip = WheelSlipCheck(geometry, ids) if motion and follows else None
    aligned = alignment_parameters(config)
    independent = (
        config.of(MocapConfig) is not None and not config.estimator.mocap.use and feedback != "odometry"
    )
    return Checks(
        motion=motion,
        camera=CameraOutOfPlane(aligned.tracker, aligned.tracker_scale)
        if motion and config.of(TrackerConfig)
        else None,
        estimate=MocapEstimate(motion.capture, follows=follows) if motion and independent else None,
        wheels=slip,
        radii=motion.radii(slip, config.alignment.drive_sign) if motion and slip else None,
        estimated=frozenset(
            ("tracker", "imu", "mocap") if config.estimator.mocap.use else ("tracker", "imu")
        ),
        needs_camera=follows and feedback != "odometry",
        steering=None
        if encoders is None
        else SteeringWatch(encoders, steer_ids, expected_offsets_rad(config), stops=follows),
        stops_by_steering=follows,
        holders={name: kinds()[name].noun for name in config.devices() if kinds()[name].holds_robot},
        healthy=healthy(config),
        gap_s={name: kinds()[name].max_gap_s for name in config.devices() if not kinds()[name].moves_robot},
        brought={
            name: model.not_measured
            for name in config.devices()
            if (model := model_of(config, name)).package != OURS
        },
        hold=adhesion_watch(config),
        lost_after_s=_lost_after_s(config) if follows else {},
        weight=weight_check(config, geometry) if motion and follows else None,
        rests_on=hold_keys(config),
        added=added_checks(config),
        emulated=frozenset(config.emulated()),
        served=frozenset(served_here(config)),
    )


def healthy(config: BenchConfig) -> dict[str, Healthy]:
    """Expected rate and delay of the samples, by sensor."""
    loop_hz, found = config.loop.rate_hz, {}
    for name, own in config.devices().items():
        kind = kinds()[name]
        if not kind.moves_robot:
            rate_hz = call_in_package(name, kind.package, "rate_hz", kind.rate_hz, own, loop_hz)
            found[name] = Healthy(
                rate_hz, kind.min_delivered, kind.max_age_s + _CYCLES_LATE / loop_hz, loop_hz
            )
    return found


def motion_check(config: BenchConfig, geometry: WheelGeometry) -> MotionCheck:
    """Make the check that compares the motion of camera, wheels, gyro and motion capture.

    Args:
        config: the bench configuration.
        geometry: wheels in use.
    """
    camera, believed = config.of(TrackerConfig), _SIGMAS * config.estimator.tracker.scale_sigma
    known = camera is not None and camera.scale_sigma is not None
    scale = believed + _SESSION_SCALE if known else max(believed, MocapTolerances.scale)
    return MotionCheck(geometry, on_wall=config.environment.on_wall, seen=MocapTolerances(scale=scale))


def weight_check(config: BenchConfig, geometry: WheelGeometry) -> WeightCheck | None:
    """The check of the drives' work against the weight; None off a wall, and for a robot on a tether."""
    servos, push, tilt_rad = config.of(ServosConfig), config.of(ThrustConfig), config.environment.tilt_rad
    if servos is None or not can_fall(config) or math.sin(tilt_rad) < _LEAST_ALONG:
        return None
    model = servo_model(servos.model_number or DEFAULT_MODEL)
    lifted = Lifted(
        config.robot.mass_kg,
        math.sin(tilt_rad),
        thrust_wanted_n(config),
        model.motor.torque_constant_n_m_a,
        float(geometry.radius_m.mean()),
        model.motor.inertia_kg_m2,
        config.alignment.drive_sign,
        ("robot.thrust_compensation",) if push is None else push.scale_keys,
    )
    return WeightCheck(lifted, stops=True)


def _lost_after_s(config: BenchConfig) -> dict[str, float]:
    """Silence (s), by sensor, slightly longer than the limit at which its driver raises."""
    limits = safety_limits(config).stale_s
    fails = fail_limits(config).items()
    return {name: fail_s + _LONGER_THAN_DRIVER_S for name, fail_s in fails if name in limits}


def fail_limits(config: BenchConfig) -> dict[str, float]:
    """Silence at which the driver of each sensor raises, s; only sensors with such a limit."""
    return {
        name: own.fail_after_s
        for name, own in config.devices().items()
        if not kinds()[name].moves_robot and hasattr(own, "fail_after_s")
    }


def adhesion_watch(config: BenchConfig) -> AdhesionWatch | None:
    """The check of the adhesion force; None for a bench without fan and load cells."""
    limits = adhesion_limits(config)
    return None if limits is None else AdhesionWatch(limits, can_fall=can_fall(config))


def hold_keys(config: BenchConfig) -> tuple[str, ...]:
    """Keys that scale what holds the robot on its wall, and that no second sensor confirms."""
    fan, cells, push = config.of(AdhesionConfig), config.of(LoadCellsConfig), config.of(ThrustConfig)
    alone = cells is None or bool(config.force_sensor_elsewhere())
    force = fan.ratings().keys if fan is not None and alone else ()
    return (*force, *(push.push_keys if push is not None else ()), "robot.mass_kg", "robot.centre_of_mass_m")


def can_fall(config: BenchConfig) -> bool:
    """Whether the robot falls if it loses adhesion: on a wall, without a tether."""
    return config.environment.on_wall and not config.safety.tethered


def pretended_holders(config: BenchConfig) -> tuple[str, ...]:
    """Names of emulated devices that are meant to hold a real robot that can fall; empty for none."""
    return config.emulated_holders() if can_fall(config) else ()


def adhesion_limits(config: BenchConfig) -> AdhesionLimits | None:
    """Required adhesion and its limits; None for a bench without fan and load cells.

    Of a fan and load cells in two worlds, only that of the servos' world counts.
    """
    if other := config.force_sensor_elsewhere():
        config = config.model_copy(update={other: None})
    fan, cells, push = config.of(AdhesionConfig), config.of(LoadCellsConfig), config.of(ThrustConfig)
    if fan is None and cells is None:
        return None
    safety = config.safety
    return AdhesionLimits(
        config.robot.statics(config.environment.tilt_rad, config.environment.known_friction),
        reserve=safety.adhesion_reserve,
        utilisation=safety.utilisation_limit,
        nominal_thrust_n=thrust_wanted_n(config),
        full_thrust_n=0.0 if push is None else push.full_force_n,
        wanted_n=force_wanted_n(config),
        zero_n=None if cells is None else sum(cells.zero_n),
        reports_thrust=isinstance(push, DaemonMotorConfig),
        stale_s=safety.adhesion_stale_s,
        fan=None if fan is None else fan.ratings(),
        low_input_v=0.0 if fan is None else fan.low_input_v,
        hot_fet_c=math.inf if fan is None else fan.hot_fet_c,
    )


def thrust_wanted_n(config: BenchConfig) -> float:
    """Set-point of the propellers, N: `thrust.force_n`, or the configured share of the weight."""
    push, robot = config.of(ThrustConfig), config.robot
    if push is not None and push.force_n is not None:
        return push.force_n
    along = robot.weight_n * math.sin(config.environment.tilt_rad)
    return robot.thrust_compensation * along if config.environment.on_wall else 0.0


def force_wanted_n(config: BenchConfig) -> float:
    """Set-point of the fan, N: `adhesion.force_n`, or `robot.edf_force_n`."""
    fan = config.of(AdhesionConfig)
    return config.robot.edf_force_n if fan is None or fan.force_n is None else fan.force_n


def alignment_parameters(config: BenchConfig) -> AlignmentParameters:
    """Zeros, signs, mounts and the camera's scale of a configuration."""
    imu, tracker = config.of(ImuConfig) or ImuConfig(), config.of(TrackerConfig) or TrackerConfig()
    return AlignmentParameters(
        **config.alignment.model_dump(),
        imu=Mount(imu.mount_position_m, imu.mount_rotation_wxyz),
        tracker=Mount(tracker.mount_position_m, tracker.mount_rotation_wxyz),
        tracker_scale=tracker.scale,
        on_wall=config.environment.on_wall,
    )


def geometry_of(config: BenchConfig) -> WheelGeometry:
    """Nominal wheel geometry of the configured robot, with its wheel loads at heading 0."""
    robot = config.robot
    return WheelGeometry(
        np.array(robot.wheel_x_m),
        np.array(robot.wheel_y_m),
        np.array(robot.wheel_radius_m),
        load=4.0 * load_shares(config),
        creep_ratio=robot.creep_ratio,
    )


def nominal_of(config: BenchConfig) -> Nominal:
    """Nominal data of the configured robot, for calibration and evaluation."""
    limits_rad = [config.control.steering_limit_rad, config.safety.steering_limit_rad]
    servos = config.of(ServosConfig)
    if servos is not None:
        limits_rad.append(servos.steer_limit_rad)
    return Nominal(geometry_of(config), min(limits_rad), f"bench {config.name}")


def load_shares(config: BenchConfig) -> Array:
    """Share of the normal load on each wheel (4,) at heading 0, computed by statics from the robot's data."""
    on_wall = config.environment.on_wall
    loads = config.robot.wheel_loads_n(math.pi / 2.0 if on_wall else 0.0, adheres=on_wall)
    return np.asarray(loads / loads.sum(), dtype=np.float64)


def wheel_model(fitted_with: str) -> str:
    """Value of `estimator.wheels.model` that fits calibrations of a forward model."""
    return _WHEEL_MODELS.get(fitted_with, fitted_with)


def with_wheel_model(config: BenchConfig, fitted_with: str, *, given: bool | None = None) -> BenchConfig:
    """A configuration whose estimators use the wheel model that the calibration was fitted with.

    A model named in the bench file is kept, and a difference is a warning: calibrated wheel data are
    effective values, valid for their own model only (`docs/calibration.md`).

    Args:
        config: the bench configuration.
        fitted_with: forward model of the calibration (`hil.robot.kinematics.MODELS`).
        given: True if the file names a model; None to look whether it was set.
    """
    estimator = config.estimator
    wheels, wanted = estimator.wheels, wheel_model(fitted_with)
    if wheels.model == wanted:
        return config
    if "model" in wheels.model_fields_set if given is None else given:
        LOG.warning(
            "the calibration was fitted with the %s model and belongs to estimator.wheels.model = %r; "
            "the bench file says %r",
            fitted_with,
            wanted,
            wheels.model,
        )
        return config
    LOG.info("estimator.wheels.model = %r, as the calibration was fitted", wanted)
    changed = estimator.model_copy(update={"wheels": wheels.model_copy(update={"model": wanted})})
    return config.model_copy(update={"estimator": changed})


def with_measured_scale(config: BenchConfig) -> BenchConfig:
    """A configuration whose filters start from the measured uncertainty of the camera's scale.

    `estimator.tracker.scale_sigma` is kept if the bench file or a preset sets it; a difference is a
    warning. Without a measurement nothing changes.
    """
    tracker = config.of(TrackerConfig)
    measured = None if tracker is None else tracker.scale_sigma
    estimator, noise = config.estimator, config.estimator.tracker
    if measured is None or noise.scale_sigma == measured:
        return config
    if "scale_sigma" in noise.model_fields_set:
        LOG.warning(
            "tracker.scale_sigma = %g was measured; estimator.tracker.scale_sigma = %g is given and is used",
            measured,
            noise.scale_sigma,
        )
        return config
    changed = estimator.model_copy(update={"tracker": noise.model_copy(update={"scale_sigma": measured})})
    return config.model_copy(update={"estimator": changed})
