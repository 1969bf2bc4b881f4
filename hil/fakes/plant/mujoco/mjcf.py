"""The MJCF of a robot: generated from its true parameters, or read from a file and checked.

The generated robot is a chassis, four forks that steer, and four wheels. The MJCF describes the robot alone;
`hil.fakes.plant.mujoco.model` adds surface, contacts, motors, fan and propellers, also to a user's own file.

Assumptions beyond the bench file: forks and wheels weigh a hundredth of the robot each, roll and pitch
inertia are 0.6 of yaw, and each axle is as high as its wheel's radius, so that all four wheels touch. A real
chassis and tyres deform until they do; a rigid body on wheels that differ by 0.2 mm would rock on two.
"""

import logging
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import ConfigError, did_you_mean
from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.fakes.plant.parameters import TrueParameters
from hil.support.extras import how_to_install, why_unusable

_PART = 0.01
_ROLL_SHARE = 0.6
_HALF_WIDTH_M = 0.012
_FORK_INERTIA_KG_M2 = 1e-5
_log = logging.getLogger(__name__)
LONGEST_STEP_S = 0.002
_ROUND = ("SPHERE", "ELLIPSOID", "CYLINDER", "CAPSULE")
_PARSER = re.compile(r"XML_ERROR_(\w+)")
_LINE = re.compile(r"line (?:number=)?([1-9]\d*)", re.IGNORECASE)
_ELEMENT = re.compile(r"Element (?:name )?'(\w+)'")


def describe_robot(p: TrueParameters) -> str:
    """Return the MJCF; body frame x forward, y left, z away from the surface on which its origin lies.

    Raises:
        ConfigError: the yaw inertia is too small for the positions of the wheels.
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
    """Mass, centre and yaw inertia of the chassis, such that the whole robot has the given ones."""
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


JOINTS = (*(f"drive_{w}" for w in WHEELS), *(f"steer_{w}" for w in WHEELS))


def load_mujoco() -> Any:
    """Import MuJoCo; raises `ConfigError` with the command that installs it, or with the import's error."""
    why = why_unusable("mujoco")
    if why:
        raise ConfigError(
            f"emulation.plant = 'mujoco' needs the extra mujoco: {why}", remedy=how_to_install("mujoco")
        )
    try:
        import mujoco

        silent = mujoco.get_mju_user_warning() is None
    except Exception as error:  # whatever a broken installation raises: a library, a module in its way
        install = how_to_install("mujoco", again=True)
        raise ConfigError(
            f"emulation.plant = 'mujoco': `import mujoco` fails: {type(error).__name__}: {error}",
            remedy=f"see that nothing else here is called mujoco, then {install}",
        ) from error
    if silent:  # it would write MUJOCO_LOG.TXT into the current directory
        mujoco.set_mju_user_warning(_log.warning)
    return mujoco


def read_robot(mj: Any, p: TrueParameters, mjcf: Path | None) -> Any:
    """Return the robot as MuJoCo's `MjSpec`, read from the file or generated.

    Raises:
        ConfigError: the file cannot be read, or does not describe one robot on four wheels.
    """
    if mjcf is not None and not mjcf.is_file():
        raise ConfigError(f"emulation.mjcf = {mjcf}: no such file", expected="an MJCF file")
    try:
        spec = mj.MjSpec.from_string(describe_robot(p)) if mjcf is None else mj.MjSpec.from_file(str(mjcf))
    except (ValueError, OSError) as error:
        raise _unreadable(named(mjcf), str(error)) from None
    _check(mj, spec, named(mjcf))
    _set_back(mj, spec)
    return spec


def _set_back(mj: Any, spec: Any) -> None:
    """Reset to MuJoCo's defaults what the bench brings: options, what joints and bodies do by themselves."""
    fresh = mj.MjSpec()
    body = fresh.worldbody.add_body()
    joint = body.add_joint()
    reset(spec.option, fresh.option, keep=("timestep",))
    reset(spec.stat, fresh.stat)
    spec.compiler.alignfree = fresh.compiler.alignfree
    for one in spec.joints:
        reset(one, joint, keep=("name", "type", "axis", "pos"))
    for one in spec.bodies[1:]:
        one.gravcomp, one.mocap, one.sleep = body.gravcomp, body.mocap, body.sleep


_IDENTITY = frozenset(
    ("classname", "compiler", "frame", "id", "info", "parent", "plugin", "signature", "userdata")
)


def reset(element: Any, fresh: Any, keep: Collection[str] = ()) -> None:
    """Give an element of a robot's file the values of a fresh one, but for some attributes."""
    for name in dir(fresh):
        value = getattr(fresh, name)
        if name.startswith("_") or name in _IDENTITY or name in keep or callable(value):
            continue
        if isinstance(value, np.ndarray):
            getattr(element, name)[:] = value
        else:
            setattr(element, name, value)


def named(mjcf: Path | None) -> str:
    """Name of the robot's source, for messages."""
    return "the generated robot" if mjcf is None else str(mjcf)


def compiled(spec: Any, source: str) -> Any:
    """Compile a robot; raises `ConfigError` if MuJoCo cannot."""
    try:
        return spec.compile()
    except ValueError as error:
        raise _unreadable(source, str(error)) from None


def _unreadable(source: str, said: str) -> ConfigError:
    """Error with MuJoCo's message, line and element."""
    what = re.sub(r"^(XML )?(Error: )+", "", said.strip().splitlines()[0])
    parser, line, element = (pattern.search(said) for pattern in (_PARSER, _LINE, _ELEMENT))
    if parser is not None:
        what = f"no well-formed XML ({parser[1].lower().replace('_', ' ')})"
    at = (f", line {line[1]}" if line else "") + (f", {element[1]}" if element else "")
    return ConfigError(
        f"emulation.mjcf = {source}{at}: {what}",
        remedy="correct the file; docs/wall.md has a robot to begin with",
    )


def wheel_geoms(joint: Any) -> list[Any]:
    """Geoms of a drive's body that can touch the surface."""
    return [g for g in joint.parent.geoms if _collides(g) and g.type.name[7:] in _ROUND]


def _collides(geom: Any) -> bool:
    return bool(geom.contype or geom.conaffinity)


def _check(mj: Any, spec: Any, source: str) -> None:
    """Raise `ConfigError` with all problems if a file is not one robot on four wheels."""
    free = [j for j in spec.joints if j.type == mj.mjtJoint.mjJNT_FREE]
    problems = [*_joints(mj, spec, free), *_surroundings(spec, free)]
    if spec.actuators:
        problems.append(f"{len(spec.actuators)} actuators; expected none: the bench brings motors and fan")
    step = spec.option.timestep
    if not 0.0 < step <= LONGEST_STEP_S:
        problems.append(
            f"option timestep = {step:g} s is unstable with servos; expected {LONGEST_STEP_S:g} or less"
        )
    raise_if_any(source, problems)


def raise_if_any(source: str, problems: list[str]) -> None:
    """Raise `ConfigError` if there are problems."""
    if problems:
        raise ConfigError(f"emulation.mjcf = {source}: {len(problems)} problem(s)", problems=tuple(problems))


def _joints(mj: Any, spec: Any, free: list[Any]) -> list[str]:
    """Problems with the joints and with the wheels on them."""
    problems: list[str] = []
    known = {joint.name: joint for joint in spec.joints}
    for name in JOINTS:
        if name not in known:
            near = did_you_mean(name, [j for j in known if j and j not in JOINTS])
            problems.append(f"joint {name} is missing{'; ' + near if near else ''}")
        elif known[name].type != mj.mjtJoint.mjJNT_HINGE:
            problems.append(f"joint {name} is not a hinge")
        elif name.startswith("drive") and len(wheel_geoms(known[name])) != 1:
            problems.append(
                f"the body of joint {name} has {len(wheel_geoms(known[name]))} geoms that can collide; "
                f"expected one, its wheel ({', '.join(_ROUND).lower()}); others get contype=conaffinity=0"
            )
    if len(free) != 1:
        problems.append(f"{len(free)} free joints; expected one, <freejoint/> in the robot's body")
    others = [
        j.name or "a joint without a name" for j in spec.joints if j not in free and j.name not in JOINTS
    ]
    if others:
        problems.append(f"joints beside the eight of four wheels: {', '.join(others)}; fix them or weld them")
    return problems


def _surroundings(spec: Any, free: list[Any]) -> list[str]:
    """Problems with other objects that could touch the robot: nothing but the bench's surface may."""
    problems: list[str] = []
    if len(free) == 1:
        robots = free[0].parent
        mine = [robots, *robots.find_all("body")]
        strange = [g for g in spec.geoms if _collides(g) and g.parent not in mine]
        problems += [
            f"geom {g.name or 'without a name'} ({g.type.name[7:].lower()}) is not of the robot: the bench "
            "brings the surface, and nothing stands on it; take it out, or give it contype=conaffinity=0"
            for g in strange
        ]
    for what in ("contact pairs", "equalities", "tendons", "flexes", "plugins"):
        if found := len(getattr(spec, what.split()[-1])):
            problems.append(f"{found} {what}; expected none: the bench brings all forces and contacts")
    return problems
