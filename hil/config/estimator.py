"""Estimation: which filter, on which engine, with which noise; units are in the names.

A power density carries the unit of its root: `acceleration_m_s2_sqrt_hz` 0.3 lets the speed wander by
0.3 m/s in one second. The defaults were fitted to the authors' public
recordings (`docs/estimation.md` says how).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, model_validator

from hil.config.field_types import Strict, Switch, Within
from hil.core.errors import ConfigError
from hil.core.known_names import EstimatorName

Share = Annotated[float, Within(-1.0, 1.0, "m or rad per rolled m")]
PerMetre = tuple[Share, Share, Share]
Sigma = Annotated[float, Within(1e-9, 10.0, "beyond it nothing is believed, or all")]
"""A standard deviation that may not vanish."""
Spread = Annotated[float, Within(0.0, 10.0, "beyond it nothing is believed")]
"""A standard deviation that may be 0: there is none of it."""
Scale = Annotated[float, Within(0.0, 0.2, "a scale less known than that was not measured")]
Step = Annotated[float, Within(1e-4, 10.0, "m, rad, m/s or rad/s of a jump")]
Threshold = Annotated[float, Within(0.1, 1000.0, "chi-squared; nothing is an outlier beyond 31 sigma")]


class ProcessNoise(Strict):
    """Changes of the motion between measurements.

    Attributes:
        acceleration_m_s2_sqrt_hz, angular_acceleration_rad_s2_sqrt_hz: random walk of the body twist.
    """

    acceleration_m_s2_sqrt_hz: Sigma = 0.15
    angular_acceleration_rad_s2_sqrt_hz: Sigma = 0.2


class WheelNoise(Strict):
    """Wheel displacement between two servo reads, per wheel and component.

    Attributes:
        model: `equations` takes each wheel's two components with a gate of its own (least squares when
            none is gated); the others take one body displacement of that forward model
            (`hil.robot.kinematics`).
        source: servo `position`, or the truncated and lagging `velocity` register.
        step_m: noise of one displacement (quantisation, backlash).
        per_sqrt_m: random slip, m per square root of rolled metre.
        per_sqrt_s: random creep of a wheel at rest, m per square root of a second.
        steering_m_rad: m of noise per radian that the module turned during the step.
        longest_gap_s: longest interval that is taken for one displacement.
        friction_window_s: wheel steps that `dry-friction` and `creep` evaluate together.
    """

    model: Literal["equations", "exact", "paper", "dry-friction", "creep"] = "equations"
    source: Literal["position", "velocity"] = "position"
    step_m: Sigma = 3.0e-5
    per_sqrt_m: Spread = 2.0e-3
    per_sqrt_s: Spread = 2.0e-5
    steering_m_rad: Spread = 5e-3
    longest_gap_s: Annotated[float, Within(0.001, 10.0, "s; the robot drives 1.2 m in 10 s")] = 0.5
    friction_window_s: Annotated[float, Within(0.01, 1.0, "s; a few wheel steps")] = 0.3


class SlipModel(Strict):
    """Slip, which the wheels cannot see; one table for the wall, one for the floor.

    Attributes:
        slip_m_s: standard deviation of the slip velocity along gravity (Ornstein-Uhlenbeck, wall x); sag.
        slip_across_m_s: the same across gravity (wall y).
        slip_time_s: its time constant.
        creep: prior standard deviation of the slip per rolled metre along gravity (wall x, m/m).
        creep_across: the same across gravity, where no weight pulls: what calibration left of the wheels'
            own scale. Small, so that a stretch across teaches the camera's scale.
        creep_per_sqrt_m: random walk of `creep` per square root of rolled metre; across in proportion.
        yaw_rad_m: prior standard deviation of the turn per rolled metre.
        yaw_per_sqrt_m: its random walk per square root of rolled metre.
        known_up, known_down, known_left, known_right: slip per rolled metre when driving in that direction,
            as `surface_identification` found it: along wall x and wall y (m/m), and turn (rad/m). `creep`,
            `creep_across` and `yaw_rad_m` are then priors of what is left.
    """

    slip_m_s: Spread
    slip_across_m_s: Spread = 1e-4
    slip_time_s: Annotated[float, Within(0.5, 60.0, "s")] = 5.0
    creep: Spread
    creep_across: Spread = 0.002
    creep_per_sqrt_m: Spread = 0.01
    yaw_rad_m: Spread = 0.01
    yaw_per_sqrt_m: Spread = 0.002
    known_up: PerMetre = (0.0, 0.0, 0.0)
    known_down: PerMetre = (0.0, 0.0, 0.0)
    known_left: PerMetre = (0.0, 0.0, 0.0)
    known_right: PerMetre = (0.0, 0.0, 0.0)


class GyroNoise(Strict):
    """Inertial unit.

    Attributes:
        rate_rad_s: noise of one rate sample.
        bias_rad_s, bias_rad_s_sqrt_s: prior of the bias, and its random walk.
        gravity_rad, gravity_per_m_s2: noise of one gravity heading, and more of it per body acceleration.
        gravity_offset_rad: prior of the constant error of the gravity heading.
        use_gravity: true to use the gravity heading on the wall.
    """

    rate_rad_s: Sigma = 0.003
    bias_rad_s: Spread = 0.01
    bias_rad_s_sqrt_s: Spread = 1e-5
    gravity_rad: Sigma = 0.02
    gravity_per_m_s2: Spread = 0.1
    gravity_offset_rad: Spread = 0.005
    use_gravity: Switch = True


class TrackerNoise(Strict):
    """Tracking camera, as a pose relative to a frame that was cloned from the robot's pose and drifts.

    Attributes:
        use: `relative` (drifting frame) or `absolute` (the frame stays where it was cloned), or `off`.
        position_m, heading_rad: white noise of one pose.
        drift_per_sqrt_m, drift_per_sqrt_s: random walk of the frame's position, m.
        yaw_drift_per_sqrt_s: random walk of the frame's heading about the robot, rad.
        scale_sigma: prior of the camera's scale error (free unless 0), of what is left of it where the bench
            file knows `tracker.scale`; then `tracker.scale_sigma` is the default.
        baseline_s: time after which the frame is cloned anew; 0 keeps it until a jump.
        least_quality: confidence below which a pose is dropped; the next one up is trusted half as much.
        jump_m, jump_rad, fastest_m_s, fastest_rad_s: limits of a step: beyond jump + fastest * time it is a
            jump.
    """

    use: Literal["relative", "absolute", "off"] = "relative"
    position_m: Sigma = 1.5e-3
    heading_rad: Sigma = 3e-3
    drift_per_sqrt_m: Spread = 3e-3
    drift_per_sqrt_s: Spread = 1e-4
    yaw_drift_per_sqrt_s: Spread = 7e-4
    scale_sigma: Scale = 0.005
    baseline_s: Annotated[float, Within(0.0, 86400.0, "s; 0 for no end")] = 0.0
    least_quality: Annotated[int, Within(0, 3, "a T265 has these confidences")] = 2
    jump_m: Step = 0.02
    jump_rad: Step = 0.05
    fastest_m_s: Step = 0.5
    fastest_rad_s: Step = 3.0


class MocapNoise(Strict):
    """Motion capture is ground truth and stays out of the estimate unless `use` is set.

    Attributes:
        use: true to take its poses as measurements.
        position_m, heading_rad: white noise of one pose.
    """

    use: Switch = False
    position_m: Sigma = 1e-3
    heading_rad: Sigma = 2e-3


class GateConfig(Strict):
    """chi-squared gates by degrees of freedom (0.999), and when a locked-out sensor is let in again.

    Attributes:
        on: true for the rejection of outliers.
        one_dof, three_dof: thresholds.
        reanchor_after: consecutive rejections before a sensor is re-anchored.
    """

    on: Switch = True
    one_dof: Threshold = 10.83
    three_dof: Threshold = 16.27
    reanchor_after: Annotated[int, Within(2, 10_000, "samples; 10 000 are 50 s of a camera")] = 40


class TimeConfig(Strict):
    """Stamps and history.

    Attributes:
        history_s: age up to which late samples rewind; older ones are counted and dropped.
        future_s: time ahead of the cycle beyond which a stamp is refused.
        clock: `stamp` trusts each sample's own stamp; `estimated` also follows offset and drift of each
            sensor's clock against the host's (`hil.estimator.measurement_queue`).
        nis_samples: length of the running mean of each sensor's normalised innovation.
    """

    history_s: Annotated[float, Within(1.5, 10.0, "s; some samples are 1 s late")] = 2.0
    future_s: Annotated[float, Within(0.0, 1.0, "s; a stamp so far ahead is wrong")] = 0.02
    clock: Literal["stamp", "estimated"] = "stamp"
    nis_samples: Annotated[int, Within(10, 100_000, "samples of a mean")] = 200


_WALL = SlipModel(slip_m_s=0.002, creep=0.05)
_FLOOR = SlipModel(slip_m_s=0.0002, slip_across_m_s=0.0002, creep=0.0, creep_across=0.0, yaw_rad_m=0.015)

_NO_SLIP = {
    "slip_m_s": 0.0,
    "slip_across_m_s": 0.0,
    "creep": 0.0,
    "creep_across": 0.0,
    "creep_per_sqrt_m": 0.0,
    "yaw_rad_m": 0.0,
    "yaw_per_sqrt_m": 0.0,
}
_PAPER: dict[str, dict[str, Any]] = {
    "wheels": {"model": "paper", "source": "velocity", "step_m": 1e-4, "per_sqrt_m": 3e-3},
    "wall": _NO_SLIP,
    "floor": _NO_SLIP,
    "gyro": {"bias_rad_s": 0.0, "bias_rad_s_sqrt_s": 0.0, "use_gravity": False},
    "tracker": {
        "use": "absolute",
        "position_m": 0.01,
        "heading_rad": 0.01,
        "drift_per_sqrt_m": 0.0,
        "drift_per_sqrt_s": 0.0,
        "yaw_drift_per_sqrt_s": 0.0,
        "scale_sigma": 0.0,
    },
    "gates": {"on": False},
}


_FREE_MOTION = {"acceleration_m_s2_sqrt_hz": 1.0, "angular_acceleration_rad_s2_sqrt_hz": 4.0}
"""Process noise so large that the wheels determine the motion, in translation and rotation alike."""


class EstimatorConfig(Strict):
    """`[estimator]` of the bench file.

    Attributes:
        kind: `ekf`, `ukf`, or `odometry` (wheels alone, no filter).
        engine: `compiled` (by numba) or `filterpy`.
        preset: `paper` fills what is not given with the paper's estimator: velocity register, its forward
            model, absolute camera pose, no slip, bias or gravity, no gates.
        alpha, beta, kappa: spread of the sigma points.
        wheel_scale_sigma: prior of a common wheel-radius error; only with `tracker.scale_sigma` 0, because
            both scales together cannot be observed.
        initial_twist: standard deviation given to the twist where a start state brings none.
    """

    kind: EstimatorName = "ekf"
    engine: Literal["compiled", "filterpy"] = "compiled"
    preset: Literal["recommended", "paper"] = "recommended"
    alpha: Annotated[float, Within(1e-5, 1.0, "share of a standard deviation")] = 1e-3
    beta: Annotated[float, Within(-100.0, 100.0, "2 for a normal distribution")] = 2.0
    kappa: Annotated[float, Within(-100.0, 100.0, "0, or 3 less the number of states")] = 0.0
    wheel_scale_sigma: Scale = 0.0
    process: ProcessNoise = ProcessNoise()
    wheels: WheelNoise = WheelNoise()
    wall: SlipModel = _WALL
    floor: SlipModel = _FLOOR
    gyro: GyroNoise = GyroNoise()
    tracker: TrackerNoise = TrackerNoise()
    mocap: MocapNoise = MocapNoise()
    gates: GateConfig = GateConfig()
    time: TimeConfig = TimeConfig()

    def slip(self, surface: str) -> SlipModel:
        """Slip model of a surface: `wall` or `floor`."""
        return self.wall if surface == "wall" else self.floor

    def on_wheels_alone(self) -> EstimatorConfig:
        """A copy for recordings with neither gyro nor camera; process noise that was chosen stays.

        With the noise that suits all sensors the filters expect smaller accelerations than those of a start
        or a turn: the wheels' gates then reject what no other sensor measures, and the turn is lost.
        """
        free = {k: v for k, v in _FREE_MOTION.items() if k not in self.process.model_fields_set}
        return self.model_copy(update={"process": self.process.model_copy(update=free)})

    def of_a_twist(self) -> EstimatorConfig:
        """A copy for recordings of a twist: one body displacement per sample, whose wheels do not steer."""
        rows = {"model": "exact", "source": "position", "steering_m_rad": 0.0}
        return self.model_copy(update={"wheels": self.wheels.model_copy(update=rows)})

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, given: Any) -> Any:
        """Fill slip tables from the surface's defaults and everything else from the preset."""
        if not isinstance(given, Mapping):
            return given
        tree = dict(given)
        tables: dict[str, dict[str, Any]] = {"wall": _WALL.model_dump(), "floor": _FLOOR.model_dump()}
        if tree.get("preset") == "paper":
            tables = {name: {**tables.get(name, {}), **table} for name, table in _PAPER.items()}
        for name, table in tables.items():
            section = tree.get(name, {})
            if isinstance(section, BaseModel):
                section = section.model_dump(exclude_unset=True)
            if isinstance(section, Mapping):
                tree[name] = {**table, **section}
        return tree

    @model_validator(mode="after")
    def _observable(self) -> EstimatorConfig:
        check_scales(self)
        return self


def check_scales(config: EstimatorConfig) -> None:
    """Refuse two free scales (in simulated wall drives 27 mm became 155 when both were freed).

    Raises:
        ConfigError: both may vary.
    """
    if config.wheel_scale_sigma > 0 and config.tracker.scale_sigma > 0:
        raise ConfigError(
            f"estimator: wheel_scale_sigma = {config.wheel_scale_sigma:g} and tracker.scale_sigma = "
            f"{config.tracker.scale_sigma:g} are both free, but no data can tell them apart",
            expected="one of them 0",
        )
