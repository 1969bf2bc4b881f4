"""The parts of the three-dimensional view, from the bench's configuration; plain data, no Rerun.

A `Scene` is what does not change while the robot moves: its geometry and looks, the surface that it stands
on and how steep that is. `hil.monitor.solid_geometry` has the geometry, `hil.monitor.robot_view` draws it.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hil.config.bench import BenchConfig
from hil.config.device import DeviceConfig, MountedConfig
from hil.config.environment import EnvironmentConfig
from hil.config.monitor import MonitorConfig
from hil.config.robot import RobotConfig
from hil.core.errors import ConfigError
from hil.robot.kinematics import WheelGeometry

LOG = logging.getLogger(__name__)

Range = tuple[float, float]


@dataclass(frozen=True)
class Mounted:
    """A device on the robot.

    Attributes:
        name: name of the device on the bench.
        position_m, rotation_wxyz: its frame in the body.
    """

    name: str
    position_m: tuple[float, ...]
    rotation_wxyz: tuple[float, ...]


@dataclass(frozen=True)
class Scene:
    """A robot and the surface that it stands on.

    Attributes:
        geometry: geometry of the wheels, nominal or calibrated.
        robot: masses, outline, fan and propellers.
        environment: surface and its tilt.
        looks: mesh given by the user.
        x_range_m, y_range_m: usable surface in the wall frame; None where it has no bounds.
        mounted: devices that have a place on the robot.
        devices: tables of the bench's devices, by name on the bench.
    """

    geometry: WheelGeometry = field(default_factory=WheelGeometry.nominal)
    robot: RobotConfig = field(default_factory=RobotConfig)
    environment: EnvironmentConfig = field(default_factory=EnvironmentConfig)
    looks: MonitorConfig = field(default_factory=MonitorConfig)
    x_range_m: Range | None = None
    y_range_m: Range | None = None
    mounted: tuple[Mounted, ...] = ()
    devices: Mapping[str, DeviceConfig] = field(default_factory=dict)

    @classmethod
    def of(cls, config: BenchConfig, geometry: WheelGeometry, *, recorded: bool = False) -> Scene:
        """The scene of a bench.

        Args:
            config: configuration of the bench.
            geometry: geometry of its wheels as it uses them.
            recorded: True for a configuration from a recording: a mesh that is no longer there is left out.

        Raises:
            ConfigError: the mesh that the bench file names is not there.
        """
        looks = config.monitor
        mesh = looks.mesh
        if mesh is not None and not Path(mesh).is_file():
            if recorded:
                LOG.warning("monitor.mesh: %s is not here: the robot is drawn from [robot]", mesh)
                looks = MonitorConfig()
            else:
                raise ConfigError(
                    f"monitor.mesh: {mesh} is no file",
                    expected="a mesh of the robot's body",
                    remedy="correct the path, or leave it out: the robot is then drawn from [robot]",
                )
        return cls(
            geometry,
            config.robot,
            config.environment,
            looks,
            config.environment.x_range_m,
            config.environment.y_range_m,
            tuple(
                Mounted(name, device.mount_position_m, device.mount_rotation_wxyz)
                for name, device in config.devices().items()
                if isinstance(device, MountedConfig)
            ),
            config.devices(),
        )

    @property
    def tilt_rad(self) -> float:
        """Steepness of the surface: 0 floor, pi/2 wall."""
        return self.environment.tilt_rad
