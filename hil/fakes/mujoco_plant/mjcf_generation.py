"""MJCF of a robot, made from its true parameters: a chassis, four forks that steer, four wheels.

The file describes the robot alone. Surface, contacts, motors, fan and propellers are added to it, and to a
file of the user's own, by `hil.fakes.mujoco_plant.model`.

What a bench file does not say is assumed: forks and wheels weigh a hundredth of the robot each, roll and
pitch inertia are 0.6 of yaw, and the axles stand as high as the wheels are large, so that all four touch: a
real chassis and tyres give way until they do, a rigid body on wheels that differ by 0.2 mm rocks on two.
"""

from __future__ import annotations

import numpy as np

from hil.core.errors import ConfigError
from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.fakes.plant.parameters import TrueParameters

_PART = 0.01
_ROLL_SHARE = 0.6
_HALF_WIDTH_M = 0.012
_FORK_INERTIA_KG_M2 = 1e-5


def describe_robot(p: TrueParameters) -> str:
    """The MJCF; body frame x forward, y left, z away from the surface on which its origin lies.

    Raises:
        ConfigError: the yaw inertia is too small for wheels where they are.
    """
    mass, centre, inertia = _chassis(p)
    modules = "".join(_module(p, i) for i in range(4))
    roll = _ROLL_SHARE * inertia
    return f"""<mujoco model="robot">
  <worldbody>
    <body name="robot">
      <freejoint/>
      <inertial pos="{_numbers(centre)}" mass="{mass:.9g}" diaginertia="{roll:.9g} {roll:.9g} {inertia:.9g}"/>
{modules}    </body>
  </worldbody>
</mujoco>
"""


def _chassis(p: TrueParameters) -> tuple[float, Array, float]:
    """Mass, centre and yaw inertia of what is neither fork nor wheel, so that the whole robot is as given."""
    part = 2.0 * _PART * p.mass_kg
    places = np.column_stack([p.wheel_x_m, p.wheel_y_m, p.wheel_radius_m])
    mass, whole = p.mass_kg - 4.0 * part, np.array(p.centre_of_mass_m)
    centre = (p.mass_kg * whole - part * places.sum(axis=0)) / mass
    around = part * np.sum((places - whole)[:, :2] ** 2) + mass * np.sum((centre - whole)[:2] ** 2)
    inertia = p.yaw_inertia_kg_m2 - float(around)
    if inertia <= 0.1 * p.yaw_inertia_kg_m2:
        raise ConfigError(
            f"robot.yaw_inertia_kg_m2 = {p.yaw_inertia_kg_m2:.3g} is too small for the MuJoCo plant",
            expected=f"more than {around / 0.9:.3g}, which forks and wheels that weigh "
            f"{4.0 * part:.2g} kg in all have by themselves where [robot] puts them",
        )
    return mass, centre, inertia


def _module(p: TrueParameters, i: int) -> str:
    wheel, radius, part = WHEELS[i], float(p.wheel_radius_m[i]), _PART * p.mass_kg
    place = _numbers([p.wheel_x_m[i], p.wheel_y_m[i], radius])
    small = _FORK_INERTIA_KG_M2
    return f"""      <body name="fork_{wheel}" pos="{place}">
        <joint name="steer_{wheel}" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="{part:.9g}" diaginertia="{small:g} {small:g} {small:g}"/>
        <body name="wheel_{wheel}">
          <joint name="drive_{wheel}" axis="0 1 0"/>
          <geom type="ellipsoid" size="{radius:.9g} {_HALF_WIDTH_M:g} {radius:.9g}" mass="{part:.9g}"/>
        </body>
      </body>
"""


def _numbers(values: Array | list[float]) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)
