"""The MuJoCo model of a bench: a robot's MJCF, generated or the user's, on a surface, with motors and fan.

The robot's file says what it weighs and where its joints and wheels are. What `[robot]`, `[environment]` and
the servos say is added here: surface, contacts, gear friction and rotors, fan, propellers.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.fakes.mujoco_plant import kernel as mk
from hil.fakes.mujoco_plant.contact import (
    FRICTION_TIME_CONSTANT_S,
    IMPEDANCE,
    TIME_CONSTANT_S,
    ContactSetting,
)  # fmt: skip
from hil.fakes.mujoco_plant.description import WHEELS, describe_robot
from hil.fakes.plant.parameters import TrueParameters
from hil.vocabulary.errors import ConfigError, did_you_mean
from hil.vocabulary.extras import how_to_install, lacks

_log = logging.getLogger(__name__)
JOINTS = (*(f"drive_{w}" for w in WHEELS), *(f"steer_{w}" for w in WHEELS))
Indices = np.ndarray[Any, np.dtype[np.int64]]
LONGEST_STEP_S = 0.002
STEP_S = 0.001
_FORK_ARMATURE_KG_M2 = 1e-3
"""Of steering gears and rotors: more than a fork itself has, so that what acts on it hardly turns it."""
_ROUND = ("SPHERE", "ELLIPSOID", "CYLINDER", "CAPSULE")
_AXES = {"drive": ((0.0, 1.0, 0.0), "+y, to the left"), "steer": ((0.0, 0.0, 1.0), "+z, off the surface")}
_AGREE = 0.999
_SURFACE_M = 100.0
_TOLERANCE = 1e-6
"""Of the solver: two orders finer change a path by a micrometre per metre, and cost a tenth more."""


@dataclass(frozen=True)
class Built:
    """A compiled model and where things stand in it.

    Attributes:
        model, data: of MuJoCo.
        indices: `a` of `hil.fakes.mujoco_plant.kernel`.
        fan, thrust, turn: actuators of adhesion (N), both propellers (N) and their imbalance (N m).
        wheel_of: number of the wheel that a geom is.
        lowest_m: how high the lowest wheel stands above the surface where the file puts the robot.
        contact: what the contacts are set to.
        source: what the robot was read from, for messages.
    """

    model: Any
    data: Any
    indices: Indices
    fan: int
    thrust: int
    turn: int
    wheel_of: dict[int, int]
    lowest_m: float
    contact: ContactSetting
    source: str


def load_mujoco() -> Any:
    """The engine; raises `ConfigError` with the line that installs it."""
    why = lacks("mujoco")
    if why:
        raise ConfigError(
            f"emulation.plant = 'mujoco' needs the extra mujoco: {why}", remedy=how_to_install("mujoco")
        )
    import mujoco

    if mujoco.get_mju_user_warning() is None:  # it would write MUJOCO_LOG.TXT where the user stands
        mujoco.set_mju_user_warning(_log.warning)
    return mujoco


def build_model(
    p: TrueParameters, contact: ContactSetting, mjcf: Path | None = None, step_s: float | None = None
) -> Built:
    """Compile the robot on its surface.

    Args:
        p: what the robot truly is; of a robot from a file only motors, fan and friction are taken from here.
        contact: how wheels touch the surface.
        mjcf: the user's own robot; generated without one.
        step_s: internal step; that of the user's file, or 1 ms.

    Raises:
        ConfigError: the engine is missing, or the file does not describe such a robot.
    """
    mj = load_mujoco()
    source = str(mjcf) if mjcf is not None else "the generated robot"
    try:
        spec = mj.MjSpec.from_file(source) if mjcf is not None else mj.MjSpec.from_string(describe_robot(p))
    except (ValueError, OSError) as error:
        raise ConfigError(f"emulation.mjcf = {source}: {_first_line(error)}") from None
    if mjcf is None or step_s is not None:
        spec.option.timestep = STEP_S if step_s is None else step_s
    _check(mj, spec, source)
    names = _dress(mj, spec, p, contact)
    try:
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"emulation.mjcf = {source}: {_first_line(error)}") from None
    _set_motors(model, p)
    data = mj.MjData(model)
    mj.mj_setConst(model, data)
    mj.mj_forward(model, data)
    _check_axes(model, data, source)
    fan, thrust, turn = (int(model.actuator(name).id) for name in ("fan", "thrust", "turn"))
    a = _indices(model, names)
    geoms = _geoms(model, a)
    lowest_m = min(float(data.geom_xpos[g][2] - model.geom_size[g][0]) for g in geoms)
    wheel_of = {geom: i for i, geom in enumerate(geoms)}
    return Built(model, data, a, fan, thrust, turn, wheel_of, lowest_m, contact, source)


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0]


def _check(mj: Any, spec: Any, source: str) -> None:
    """Refuse a file that is not one robot on four wheels, naming everything that is wrong with it."""
    problems: list[str] = []
    known = {joint.name: joint for joint in spec.joints}
    for name in JOINTS:
        if name not in known:
            near = did_you_mean(name, [j for j in known if j and j not in JOINTS])
            problems.append(f"joint {name} is missing{'; ' + near if near else ''}")
        elif known[name].type != mj.mjtJoint.mjJNT_HINGE:
            problems.append(f"joint {name} is not a hinge")
        elif name.startswith("drive") and len(_wheels(known[name])) != 1:
            problems.append(
                f"the body of joint {name} has {len(_wheels(known[name]))} geoms that can collide; "
                f"expected one, its wheel ({', '.join(_ROUND).lower()}); others get contype=conaffinity=0"
            )
    free = [j for j in spec.joints if j.type == mj.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        problems.append(f"{len(free)} free joints; expected one, <freejoint/> in the robot's body")
    others = [
        j.name or "a joint without a name" for j in spec.joints if j not in free and j.name not in JOINTS
    ]
    if others:
        problems.append(f"joints beside the eight of four wheels: {', '.join(others)}; fix them or weld them")
    if spec.actuators:
        problems.append(f"{len(spec.actuators)} actuators; expected none: the bench brings motors and fan")
    step = spec.option.timestep
    if not 0.0 < step <= LONGEST_STEP_S:
        problems.append(
            f"option timestep = {step:g} s is unstable with servos; expected {LONGEST_STEP_S:g} or less"
        )
    if problems:
        raise ConfigError(f"emulation.mjcf = {source}: {len(problems)} problem(s)", problems=tuple(problems))


def _wheels(joint: Any) -> list[Any]:
    """Geoms of a drive's body that could touch the surface."""
    return [g for g in joint.parent.geoms if (g.contype or g.conaffinity) and g.type.name[7:] in _ROUND]


def _dress(mj: Any, spec: Any, p: TrueParameters, contact: ContactSetting) -> tuple[str, ...]:
    """Add surface, contacts, motors, fan and propellers; returns the names of the wheels' contact pairs."""
    option = spec.option
    option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    option.noslip_iterations = contact.noslip_passes
    option.tolerance = _TOLERANCE
    option.disableflags |= int(mj.mjtDisableBit.mjDSBL_AUTORESET)
    if hasattr(mj.mjtDisableBit, "mjDSBL_ISLAND"):
        option.disableflags |= int(mj.mjtDisableBit.mjDSBL_ISLAND)
    wheels = [_wheels(spec.joint(f"drive_{w}"))[0] for w in WHEELS]
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    spec.worldbody.add_geom(
        name="bench_surface", type=mj.mjtGeom.mjGEOM_PLANE, size=[_SURFACE_M, _SURFACE_M, 1.0], contype=0,
        conaffinity=0,
    )  # fmt: skip
    robot = next(j for j in spec.joints if j.type == mj.mjtJoint.mjJNT_FREE).parent
    robot.add_site(name="bench_fan")
    robot.add_site(name="bench_propellers", pos=[0.0, 0.0, p.propeller_height_m])
    names = tuple(f"bench_{w}" for w in WHEELS)
    for geom, name in zip(wheels, names, strict=True):
        geom.name = geom.name or f"{name}_wheel"
        spec.add_pair(
            name=name, geomname1="bench_surface", geomname2=geom.name, condim=3,
            friction=[p.contact.friction, p.contact.friction, 0.0, 0.0, 0.0],
            solref=[TIME_CONSTANT_S, 1.0], solreffriction=[FRICTION_TIME_CONSTANT_S, 1.0],
            solimp=[IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0],
        )  # fmt: skip
    for joint in JOINTS:
        spec.add_actuator(name=joint, trntype=mj.mjtTrn.mjTRN_JOINT, target=joint)
    for name, site, gear in (
        ("fan", "bench_fan", [0, 0, -1, 0, 0, 0]),
        ("thrust", "bench_propellers", [1, 0, 0, 0, 0, 0]),
        ("turn", "bench_propellers", [0, 0, 0, 0, 0, 1]),
    ):
        spec.add_actuator(name=name, trntype=mj.mjtTrn.mjTRN_SITE, target=site, gear=gear)
    return names


def _set_motors(model: Any, p: TrueParameters) -> None:
    """Rotors and gear friction of the drives; the gears that forks hang on."""
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
    """Rolling resistance of a wheel that bears a quarter of the load."""
    load_n = 0.25 * (p.adhesion_n or 9.81 * p.mass_kg)
    return p.contact.rolling_resistance * load_n * float(p.wheel_radius_m[i])


def _check_axes(model: Any, data: Any, source: str) -> None:
    problems = []
    for name in JOINTS:
        axis = np.asarray(data.xaxis[model.joint(name).id])
        expected, words = _AXES[name[:5]]
        if float(axis @ np.array(expected)) < _AGREE:
            shown = ", ".join(f"{v:.3g}" for v in axis)
            problems.append(f"joint {name} turns about ({shown}) of the robot's body; expected {words}")
    if problems:
        raise ConfigError(f"emulation.mjcf = {source}: {len(problems)} problem(s)", problems=tuple(problems))


def _indices(model: Any, pairs: tuple[str, ...]) -> Indices:
    """`a` of the kernel."""
    drives, steers = ([model.joint(f"{kind}_{w}") for w in WHEELS] for kind in ("drive", "steer"))
    a = np.zeros(28, dtype=np.int64)
    for at, values in (
        (mk.DRIVE_Q, [j.qposadr[0] for j in drives]),
        (mk.DRIVE_V, [j.dofadr[0] for j in drives]),
        (mk.DRIVE_CTRL, [model.actuator(f"drive_{w}").id for w in WHEELS]),
        (mk.STEER_Q, [j.qposadr[0] for j in steers]),
        (mk.STEER_V, [j.dofadr[0] for j in steers]),
        (mk.STEER_CTRL, [model.actuator(f"steer_{w}").id for w in WHEELS]),
        (mk.PAIR, [model.pair(name).id for name in pairs]),
    ):
        a[at : at + 4] = values
    return a


def _geoms(model: Any, a: Indices) -> list[int]:
    """The wheels' geoms, in order."""
    return [int(model.pair_geom2[k]) for k in a[mk.PAIR : mk.PAIR + 4]]


def as_built(built: Built, p: TrueParameters) -> TrueParameters:
    """True parameters with mass, centre of mass and wheels of the compiled model."""
    model, data, geoms = built.model, built.data, _geoms(built.model, built.indices)
    body, origin = int(model.jnt_bodyid[0]), np.array(data.qpos[:3])
    places = np.array([data.geom_xpos[g] - origin for g in geoms])
    radius_m = np.array([model.geom_size[g][0] for g in geoms], dtype=np.float64)
    x, y, z = (np.array(data.subtree_com[body]) - origin).tolist()
    height_m = z - float((places[:, 2] - radius_m).min())
    return replace(
        p,
        wheel_x_m=places[:, 0],
        wheel_y_m=places[:, 1],
        wheel_radius_m=radius_m,
        mass_kg=float(model.body_subtreemass[body]),
        centre_of_mass_m=(x, y, height_m),
    )
