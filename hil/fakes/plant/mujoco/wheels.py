"""The wheels of a compiled robot: positions, shapes, and comparison with the bench.

A cylinder or capsule touches a plane along a line and scrubs when it steers: 38 mm on a circle of 3 m. Such a
wheel rolls on an added ellipsoid of its radius and width, as in the generated robot, and keeps its mass and
appearance.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.config.robot import RobotConfig
from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.fakes.plant.mujoco.mjcf import JOINTS, wheel_geoms

_AXES = {"drive": ((0.0, 1.0, 0.0), "+y, to the left"), "steer": ((0.0, 0.0, 1.0), "+z, off the surface")}
_AGREE = math.cos(math.radians(2.5))
_ROUND_SHARE, _PLACE_SHARE, _RADIUS_SHARE, _MASS_FACTOR = 0.01, 0.1, 0.25, 2.0
"""Limits of a wheel's out-of-roundness and offset from its axle (share of its radius), of its position (share
of the base), of its radius, and of the robot's mass. Beyond them, file and bench describe two robots."""


@dataclass(frozen=True)
class Wheel:
    """Shape of one wheel.

    Attributes:
        shape: `sphere`, `ellipsoid`, `cylinder` or `capsule`.
        radius_m: rolling radius.
        out_of_round: largest over smallest radius about the axle, minus one.
        half_width_m: half its width along the axle.
        off_axle_m: distance between its centre and the axle.
        agreement: cosine between its own axis and the axle.
    """

    shape: str
    radius_m: float
    out_of_round: float
    half_width_m: float
    off_axle_m: float
    agreement: float


def look_at_wheel(mj: Any, model: Any, wheel: str, geom: int) -> Wheel:
    """Return the shape of the wheel on joint `drive_<wheel>`."""
    joint, turn = model.joint(f"drive_{wheel}"), np.zeros(9)
    mj.mju_quat2Mat(turn, model.geom_quat[geom])
    axle = turn.reshape(3, 3).T @ joint.axis
    size, shape = model.geom_size[geom], mj.mjtGeom(int(model.geom_type[geom])).name[7:].lower()
    along = 2
    if shape == "sphere":
        size, along = np.full(3, size[0]), int(np.argmax(np.abs(axle)))
        axle = np.sign(axle[along]) * np.eye(3)[along]
    elif shape == "ellipsoid":
        along = int(np.argmax(np.abs(axle)))
    else:
        size = np.array([size[0], size[0], size[1]])
    radii = np.delete(size, along)
    return Wheel(
        shape,
        float(radii.max()),
        float(radii.max() / radii.min()) - 1.0,
        float(size[along]),
        float(np.linalg.norm(np.cross(model.geom_pos[geom] - joint.pos, joint.axis))),
        abs(float(axle[along])),
    )


def put_on_ellipsoids(mj: Any, spec: Any, model: Any) -> list[Any]:
    """Return the four rolling geoms, in order; cylinders and capsules get a massless ellipsoid to roll on.

    Args:
        mj: the MuJoCo module.
        spec: the robot; updated.
        model: `spec` compiled with named wheels.
    """
    out = []
    for wheel in WHEELS:
        geom = wheel_geoms(spec.joint(f"drive_{wheel}"))[0]
        number = int(model.geom(geom.name).id)
        seen = look_at_wheel(mj, model, wheel, number)
        if seen.shape in ("cylinder", "capsule"):
            geom = geom.parent.add_geom(
                name=f"bench_{wheel}_tyre",
                type=mj.mjtGeom.mjGEOM_ELLIPSOID,
                mass=0.0,
                size=[seen.radius_m, seen.radius_m, seen.half_width_m],
                pos=model.geom_pos[number],
                quat=model.geom_quat[number],
            )
        out.append(geom)
    return out


def name_wheels(spec: Any) -> None:
    """Name unnamed wheels, so that they can be found in the compiled model."""
    for wheel in WHEELS:
        geom = wheel_geoms(spec.joint(f"drive_{wheel}"))[0]
        geom.name = geom.name or f"bench_{wheel}_wheel"


def at_zero(mj: Any, model: Any) -> Any:
    """Return the data of a model with all joints at zero."""
    data = mj.MjData(model)
    mj.mj_setConst(model, data)
    mj.mj_resetData(model, data)
    for name in JOINTS:
        data.qpos[model.joint(name).qposadr[0]] = 0.0
    mj.mj_forward(model, data)
    return data


def not_finite(model: Any) -> list[str]:
    """Describe the parts of a compiled robot that have non-finite numbers."""
    parts = {
        "body": ("body_mass", "body_inertia", "body_pos", "body_quat", "body_ipos", "body_iquat"),
        "joint": ("jnt_pos", "jnt_axis"),
        "geom": ("geom_size", "geom_pos", "geom_quat"),
    }
    return [
        f"{kind} {getattr(model, kind)(i).name or i}: {name.split('_')[1]} is not finite"
        for kind, names in parts.items()
        for name in names
        for i, row in enumerate(getattr(model, name))
        if not np.all(np.isfinite(row))
    ]


def mismatches(mj: Any, model: Any, geoms: list[int], robot: RobotConfig) -> list[str]:
    """Describe everything in which a compiled robot does not fit the bench: joint axes, wheels, mass."""
    data, body = at_zero(mj, model), int(model.jnt_bodyid[0])
    if abs(float(data.qpos[3])) < math.cos(0.5 * math.radians(0.1)):
        name = model.body(body).name or "of the robot"
        return [f"body {name} is turned in the file; expected no turn: [environment] says where it starts"]
    problems = []
    for name in JOINTS:
        axis, (expected, words) = data.xaxis[model.joint(name).id], _AXES[name[:5]]
        if float(axis @ np.array(expected)) < _AGREE:
            shown = ", ".join(f"{v:.3g}" for v in axis)
            problems.append(f"joint {name} turns about ({shown}) of the robot's body; expected {words}")
    places = np.array([data.geom_xpos[g] - data.xpos[body] for g in geoms])[:, :2]
    for i, wheel in enumerate(WHEELS):
        problems += _unround(wheel, look_at_wheel(mj, model, wheel, geoms[i]), robot.wheel_radius_m[i])
    problems += _displaced(places, np.column_stack([robot.wheel_x_m, robot.wheel_y_m]))
    mass = float(model.body_subtreemass[body])
    if not 1.0 / _MASS_FACTOR <= mass / robot.mass_kg <= _MASS_FACTOR:
        problems.append(
            f"the robot weighs {mass:.3g} kg; [robot] mass_kg is {robot.mass_kg:.3g}: correct the wrong one"
        )
    return problems


def _unround(name: str, wheel: Wheel, expected_m: float) -> list[str]:
    """Describe why a wheel does not roll as the bench expects."""
    what = f"wheel {name} ({wheel.shape})"
    if wheel.agreement < _AGREE:
        off_deg = math.degrees(math.acos(wheel.agreement))
        hint = '; a cylinder along z gets euler="90 0 0"' if wheel.shape in ("cylinder", "capsule") else ""
        return [f"{what}: its axis is {off_deg:.0f} deg off that of joint drive_{name}{hint}"]
    problems = []
    if wheel.out_of_round > _ROUND_SHARE:
        problems.append(f"{what} is out of round by {100.0 * wheel.out_of_round:.1f} % about its axle")
    if wheel.off_axle_m > _ROUND_SHARE * wheel.radius_m:
        problems.append(f"{what} turns {1e3 * wheel.off_axle_m:.2g} mm off its centre; expected 0")
    if abs(wheel.radius_m / expected_m - 1.0) > _RADIUS_SHARE:
        problems.append(
            f"{what} has a radius of {wheel.radius_m:.4g} m; [robot] wheel_radius_m is {expected_m:.4g}: "
            "correct the wrong one"
        )
    return problems


def _displaced(places_m: Array, expected_m: Array) -> list[str]:
    """Describe the wheels that are not where the bench expects them."""
    problems, most_m = [], _PLACE_SHARE * float(np.ptp(expected_m, axis=0).max())
    for i, wheel in enumerate(WHEELS):
        away_m = np.linalg.norm(expected_m - places_m[i], axis=1)
        if away_m[i] > most_m:
            nearest = int(np.argmin(away_m))
            hint = f"; that is the place of {WHEELS[nearest]}" if away_m[nearest] <= most_m else ""
            (x, y), (want_x, want_y) = places_m[i], expected_m[i]
            problems.append(
                f"wheel {wheel} stands at x = {x:.4g}, y = {y:.4g} m; [robot] has it at {want_x:.4g}, "
                f"{want_y:.4g}{hint}: correct the wrong one"
            )
    return problems
