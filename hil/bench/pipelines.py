"""Makes pipelines, estimators and the header of a recording from a configuration, without devices.

It has no device, clock or loop: a replay needs only this part of a bench, and gets the same pipelines from it
as the loop.
"""

from __future__ import annotations

from copy import copy

from hil.bench.loop_settings import (
    alignment_parameters,
    checks,
    motion_limits,
    safety_limits,
    with_measured_scale,
)
from hil.config.bench import BenchConfig
from hil.config.estimator import EstimatorConfig
from hil.config.servos import ServosConfig
from hil.controller import make_controller, make_modules
from hil.controller.jog import JogController, JogLimits
from hil.controller.joint_script import JointScript, ScriptedController
from hil.core.errors import UsageError
from hil.core.interfaces import Controller, Estimator, ExternalController
from hil.core.known_names import ESTIMATORS, JOG, LAWS, ROS2
from hil.estimator import make_estimator
from hil.loop.alignment import Alignment
from hil.loop.pipeline import ControlPipeline
from hil.loop.resume_motion import Restart
from hil.loop.supervisor import Supervisor
from hil.robot.kinematics import WheelGeometry
from hil.robot.motion_limits import check
from hil.robot.trajectories import Trajectory
from hil.ros2.external_controller import JointLimits, Ros2Controller
from hil.support.arithmetic_fingerprint import fingerprint
from hil.support.versions import versions


class BenchModel:
    """Configuration and wheel geometry of a bench.

    Attributes:
        config: the checked configuration, as used.
        geometry: wheel geometry in use (nominal or calibrated).
        calibration: name and version of the calibration in use; empty without one.
        fitted_with: forward model of the calibration; empty without one.
        seed: seed of the emulated world.
    """

    def __init__(
        self,
        config: BenchConfig,
        *,
        geometry: WheelGeometry,
        calibration: str = "",
        fitted_with: str = "",
        seed: int = 0,
    ) -> None:
        self.config, self.geometry, self.seed = with_measured_scale(config), geometry, seed
        self.calibration, self.fitted_with = calibration, fitted_with
        self.alignment_parameters = alignment_parameters(config)

    def with_estimator(self, estimator: EstimatorConfig) -> BenchModel:
        """The same bench with other filter settings."""
        made = copy(self)
        made.config = self.config.model_copy(update={"estimator": estimator})
        return made

    def versions(self) -> dict[str, str]:
        """Versions of the software that the result depends on."""
        return versions()

    def header(self) -> dict[str, object]:
        """Header of a recording: its origin, and all data to rebuild the pipeline of every run."""
        return {
            "config": self.config.model_dump(mode="json", by_alias=True, exclude_none=True),
            "geometry": self.geometry.vector().tolist(),
            "tyres": self.geometry.tyres(),
            "calibration": self.calibration,
            "seed": self.seed,
            "versions": self.versions(),
            "arithmetic": fingerprint(),
        }

    def make_pipeline(
        self,
        trajectory: Trajectory | JointScript | None,
        *,
        controller: str | None = None,
        feedback: str = "ekf",
        observers: tuple[str, ...] = (),
    ) -> ControlPipeline:
        """The deterministic part of the loop for one motion or script (also what replay runs).

        A program on ROS 2 (`ros2:TOPIC`) can also drive without a trajectory.

        Raises:
            UsageError: unknown feedback or controller.
        """
        config = self.config
        law: Controller | None = None
        external: ExternalController | None = None
        if isinstance(trajectory, JointScript):
            law = ScriptedController(trajectory)
        elif controller is not None and controller.startswith(ROS2):
            external = self._external(controller)
        elif controller is not None and controller.startswith(JOG):
            external = self._jog(controller)
        elif trajectory is not None:
            control = config.control
            if controller not in (None, *LAWS):
                raise UsageError(f"controller {controller!r} is unknown", expected=" or ".join(LAWS))
            if controller is not None:
                control = control.model_copy(update={"law": controller})
            law = make_controller(control, self.geometry, trajectory, rate_hz=config.loop.rate_hz)
        scripted = trajectory is None or isinstance(trajectory, JointScript)
        follows = isinstance(external, Ros2Controller) or not scripted
        restart = self._restart()
        reference_at = None
        if trajectory is not None:
            reference_at = trajectory.sample if restart is None else restart.paced(trajectory.sample)
        return ControlPipeline(
            Supervisor(
                safety_limits(config),
                checks=checks(config, self.geometry, follows=follows, feedback=feedback),
            ),
            Alignment(self.alignment_parameters),
            self.make_estimator(feedback),
            law,
            reference_at,
            {name: self.make_estimator(name, diagnostics=False) for name in observers},
            restart,
            external,
        )

    def _external(self, name: str) -> Ros2Controller:
        """Controller for a ROS 2 program that drives; not connected yet."""
        config = self.config
        limits = JointLimits(
            config.safety.wheel_rate_limit_rad_s,
            config.safety.steering_limit_rad,
            config.control.steering_rate_rad_s,
            config.ros2.late_after_s,
            1.0 / config.loop.rate_hz,
        )
        modules = make_modules(config.control, self.geometry, rate_hz=config.loop.rate_hz)
        return Ros2Controller(name, limits, self.alignment_parameters, modules)

    def _jog(self, name: str) -> JogController:
        """Controller for an operator who moves one joint; not connected yet."""
        config = self.config
        reach = JogLimits(
            config.safety.wheel_rate_limit_rad_s,
            config.control.acceleration_m_s2 / float(self.geometry.radius_m.max()),
            config.control.steering_limit_rad,
            config.control.steering_rate_rad_s,
            1.0 / config.loop.rate_hz,
        )
        return JogController(name, reach)

    def _restart(self) -> Restart | None:
        """Restart after a loop pause in which the servos' watchdogs tripped; None without watchdogs."""
        servos, control = self.config.of(ServosConfig), self.config.control
        if servos is None or not servos.watchdog_s:
            return None
        return Restart(
            servos.watchdog_s,
            control.acceleration_m_s2,
            control.wheel_speed_m_s,
            control.servo_lag_s,
            self.geometry.radius_m,
        )

    def make_estimator(self, kind: str, *, diagnostics: bool = True) -> Estimator:
        """Make an estimator for this bench, with or without diagnostics.

        Raises:
            UsageError: unknown kind.
        """
        if kind not in ESTIMATORS:
            raise UsageError(f"feedback {kind!r} is unknown", expected="one of " + ", ".join(ESTIMATORS))
        config = self.config.estimator.model_copy(update={"kind": kind})
        return make_estimator(
            config, self.geometry, surface=self.config.environment.kind, diagnostics=diagnostics
        )

    def check(self, trajectory: Trajectory, *, known: Trajectory | None = None) -> None:
        """Refuse a trajectory that exceeds the limits; arguments and errors as in `Bench.check`."""
        if not isinstance(trajectory, Trajectory):
            raise UsageError(
                f"{trajectory!r} is no trajectory",
                expected="a hil.robot.trajectories.Trajectory",
                remedy="make one there: line(start, end), circle, through, ...",
            )
        check(trajectory, self.geometry.projection(), motion_limits(self.config), known=known)
