"""The MuJoCo model of a bench: a robot's MJCF, generated or the user's, on a surface, with motors and fan.

The robot's file gives its masses, joints and wheels. This module adds what `[robot]`, `[environment]` and the
servos define: surface, contacts, gear friction and rotors, fan, propellers.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.config.robot import RobotConfig
from hil.core.geometry import Array
from hil.core.named_records import Records, filled
from hil.core.signals import WHEELS
from hil.fakes.plant.mujoco import step_kernels as mk
from hil.fakes.plant.mujoco.contact_settings import (
    FRICTION_TIME_CONSTANT_S,
    IMPEDANCE,
    TIME_CONSTANT_S,
    ContactSetting,
)
from hil.fakes.plant.mujoco.mjcf import (
    JOINTS,
    compiled,
    load_mujoco,
    named,
    raise_if_any,
    read_robot,
    reset,
    wheel_geoms,
)
from hil.fakes.plant.mujoco.named_numbers import PLACES
from hil.fakes.plant.mujoco.wheels import (
    at_zero,
    look_at_wheel,
    mismatches,
    name_wheels,
    not_finite,
    put_on_ellipsoids,
)
from hil.fakes.plant.parameters import TrueParameters
from hil.fakes.plant.robot import GRAVITY_M_S2

STEP_S = 0.001
_FORK_ARMATURE_KG_M2 = 1e-3
"""Inertia of gear and rotor: larger than a fork's own, so that forces hardly turn the fork."""
_SURFACE_M = 100.0
_TOLERANCE = 1e-6
"""Tolerance of the solver: a hundredth of it changes a path by 1 um/m and takes a tenth longer."""


@dataclass(frozen=True)
class Built:
    """A compiled model and the indices of its parts.

    Attributes:
        model, data: MuJoCo's `MjModel` and `MjData`.
        places: array (1,) of `Places`: indices into MuJoCo's vectors.
        fan, thrust, turn: actuators of adhesion (N), both propellers (N) and their imbalance (N m).
        wheel_of: wheel index by geom index.
        radius_m: (4,) rolling radii of the wheels.
        contact: contact setting.
        source: origin of the robot's description, for messages.
    """

    model: Any
    data: Any
    places: Records
    fan: int
    thrust: int
    turn: int
    wheel_of: dict[int, int]
    radius_m: Array
    contact: ContactSetting
    source: str


def build_model(
    p: TrueParameters,
    contact: ContactSetting,
    robot: RobotConfig | None = None,
    mjcf: Path | None = None,
    step_s: float | None = None,
) -> Built:
    """Compile the robot on its surface.

    Args:
        p: true parameters; for a robot from a file, only motors, fan and friction are used.
        contact: contact law of the wheels.
        robot: nominal robot, with which the file is compared; no comparison without it.
        mjcf: file of the user's own robot; generated without one.
        step_s: internal step; by default that of the user's file, or 1 ms.

    Raises:
        ConfigError: MuJoCo is missing, or the file does not describe a suitable robot.
    """
    mj, source = load_mujoco(), named(mjcf)
    spec = read_robot(mj, p, mjcf)
    if mjcf is None or step_s is not None:
        spec.option.timestep = STEP_S if step_s is None else step_s
    names = _dress(mj, spec, p, contact, _tyres(mj, spec, robot, source))
    model = compiled(spec, source)
    _set_motors(model, p)
    data = at_zero(mj, model)
    fan, thrust, turn = (int(model.actuator(name).id) for name in ("fan", "thrust", "turn"))
    places = _places(model, names)
    wheel_of = {geom: i for i, geom in enumerate(_geoms(model, places))}
    radius_m = np.array([look_at_wheel(mj, model, WHEELS[i], geom).radius_m for geom, i in wheel_of.items()])
    return Built(model, data, places, fan, thrust, turn, wheel_of, radius_m, contact, source)


def _tyres(mj: Any, spec: Any, robot: RobotConfig | None, source: str) -> list[Any]:
    """Return the four rolling geoms, after checking that the robot fits the bench."""
    name_wheels(spec)
    model = compiled(spec, source)
    raise_if_any(source, not_finite(model))
    geoms = [int(model.geom(wheel_geoms(spec.joint(f"drive_{w}"))[0].name).id) for w in WHEELS]
    if robot is not None:
        raise_if_any(source, mismatches(mj, model, geoms, robot))
    return put_on_ellipsoids(mj, spec, model)


def _dress(
    mj: Any, spec: Any, p: TrueParameters, contact: ContactSetting, tyres: list[Any]
) -> tuple[str, ...]:
    """Add surface, contacts, motors, fan and propellers; returns the names of the wheels' contact pairs."""
    option = spec.option
    option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    option.noslip_iterations = contact.noslip_passes
    option.tolerance = _TOLERANCE
    option.disableflags |= int(mj.mjtDisableBit.mjDSBL_AUTORESET)
    if hasattr(mj.mjtDisableBit, "mjDSBL_ISLAND"):
        option.disableflags |= int(mj.mjtDisableBit.mjDSBL_ISLAND)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    spec.worldbody.add_geom(
        name="bench_surface",
        type=mj.mjtGeom.mjGEOM_PLANE,
        size=[_SURFACE_M, _SURFACE_M, 1.0],
        contype=0,
        conaffinity=0,
    )
    robot = next(j for j in spec.joints if j.type == mj.mjtJoint.mjJNT_FREE).parent
    robot.add_site(name="bench_fan")
    robot.add_site(name="bench_propellers", pos=[0.0, 0.0, p.propeller_height_m])
    names = tuple(f"bench_{w}" for w in WHEELS)
    pair = mj.MjSpec().add_pair()
    for geom, name in zip(tyres, names, strict=True):
        touching = {
            "name": name,
            "geomname1": "bench_surface",
            "geomname2": geom.name,
            "condim": 3,
            "friction": [p.contact.friction, p.contact.friction, 0.0, 0.0, 0.0],
            "solref": [TIME_CONSTANT_S, 1.0],
            "solreffriction": [FRICTION_TIME_CONSTANT_S, 1.0],
            "solimp": [IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0],
        }
        reset(spec.add_pair(**touching), pair, keep=tuple(touching))
    motor = mj.MjSpec().add_actuator()
    for joint in JOINTS:
        _add_motor(spec, motor, name=joint, trntype=mj.mjtTrn.mjTRN_JOINT, target=joint)
    for name, site, gear in (
        ("fan", "bench_fan", [0, 0, -1, 0, 0, 0]),
        ("thrust", "bench_propellers", [1, 0, 0, 0, 0, 0]),
        ("turn", "bench_propellers", [0, 0, 0, 0, 0, 1]),
    ):
        _add_motor(spec, motor, name=name, trntype=mj.mjtTrn.mjTRN_SITE, target=site, gear=gear)
    return names


def _add_motor(spec: Any, motor: Any, **values: Any) -> None:
    """Add an actuator that is a plain motor, whatever the file's defaults say."""
    added = spec.add_actuator(**values)
    reset(added, motor, keep=tuple(values))


def _set_motors(model: Any, p: TrueParameters) -> None:
    """Set rotors and gear friction of drives and steering, which replace those of the file."""
    joints = p.joints
    for i, wheel in enumerate(WHEELS):
        drive, steer = (int(model.joint(f"{kind}_{wheel}").dofadr[0]) for kind in ("drive", "steer"))
        model.dof_armature[drive] = joints.inertia_kg_m2[i]
        model.dof_damping[drive] = joints.viscous_n_m_s[i]
        model.dof_frictionloss[drive] = joints.coulomb_n_m[i] + _rolling_n_m(p, i)
        model.dof_armature[steer] = _FORK_ARMATURE_KG_M2
        model.dof_damping[steer] = mk.FORK_DAMPING_N_M_S
        model.dof_frictionloss[steer] = 0.0


def _rolling_n_m(p: TrueParameters, i: int) -> float:
    """Rolling resistance torque of a wheel with a quarter of the load."""
    load_n = 0.25 * (p.adhesion_n or GRAVITY_M_S2 * p.mass_kg)
    return p.contact.rolling_resistance * load_n * float(p.wheel_radius_m[i])


def _places(model: Any, pairs: tuple[str, ...]) -> Records:
    """Indices (1,) of joints, motors and contact pairs."""
    drives, steers = ([model.joint(f"{kind}_{w}") for w in WHEELS] for kind in ("drive", "steer"))
    places = {
        "drive_q": [j.qposadr[0] for j in drives],
        "drive_v": [j.dofadr[0] for j in drives],
        "drive_ctrl": [model.actuator(f"drive_{w}").id for w in WHEELS],
        "steer_q": [j.qposadr[0] for j in steers],
        "steer_v": [j.dofadr[0] for j in steers],
        "steer_ctrl": [model.actuator(f"steer_{w}").id for w in WHEELS],
        "pair": [model.pair(name).id for name in pairs],
    }
    return filled(PLACES, places)


def _geoms(model: Any, places: Records) -> list[int]:
    """Geom indices of the wheels, wheel order."""
    return [int(model.pair_geom2[k]) for k in places[0].pair]


def as_built(built: Built, p: TrueParameters) -> TrueParameters:
    """True parameters with the masses, centre of mass and wheels of the compiled model."""
    model, data, geoms = built.model, built.data, _geoms(built.model, built.places)
    body, origin = int(model.jnt_bodyid[0]), np.array(data.qpos[:3])
    places = np.array([data.geom_xpos[g] - origin for g in geoms])
    x, y, z = (np.array(data.subtree_com[body]) - origin).tolist()
    height_m = z - float((places[:, 2] - built.radius_m).min())
    return replace(
        p,
        wheel_x_m=places[:, 0],
        wheel_y_m=places[:, 1],
        wheel_radius_m=built.radius_m,
        mass_kg=float(model.body_subtreemass[body]),
        centre_of_mass_m=(x, y, height_m),
    )
