"""Draws the scene in Rerun: wall, robot with steering and turning wheels, truth, reference, arrows.

Below `scene`, `wall` is tilted as the surface is and holds everything; `wall/estimate`, `wall/truth` and
`wall/reference` are frames that move; the wheels turn in `wall/estimate`.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.core.geometry import Array, quat_from_yaw
from hil.monitor import robot_mesh, solid_geometry
from hil.monitor.plot_series import finite
from hil.monitor.rerun_layout import PATH_COLOURS, ROBOT, SCENE, Colour
from hil.monitor.scene import Scene
from hil.monitor.scene_state import Moment

WALL = f"{SCENE}/wall"

_SURFACE: Colour = (236, 231, 220)
_GRID: Colour = (205, 199, 187)
_EDGE: Colour = (120, 130, 145)
_SLIP: Colour = (220, 40, 50)
_LOAD: Colour = (235, 140, 30)
_FORCE: Colour = (120, 90, 200)
_WEIGHT: Colour = (60, 60, 70)
_AXES = ((200, 60, 45), (30, 135, 70))
_GRID_M = 0.25
_EXPLAINED_S = 0.5 - 1e-6
_GRID_ABOVE_M, _ABOVE_M = 0.001, 0.003  # what lies on the surface, above what it lies on
_INSET_M = 0.15
_FAN_M = (0.042, 0.05)


class RobotView:
    """The three-dimensional view of one Rerun recording.

    Args:
        stream: recording that it is drawn into.
        scene: robot and surface.
    """

    def __init__(self, stream: Any, scene: Scene) -> None:
        import rerun

        self._rr, self._stream, self._scene = rerun, stream, scene
        self._outlined: set[str] = set()
        self._explained_s = -math.inf
        self._draw_frames()
        self._draw_robot()

    def surface(self, low_m: Array, high_m: Array) -> None:
        """Draw the surface: its usable part, or the part in view if it has no bounds.

        Args:
            low_m: (2,) lower corner of what is seen, wall frame.
            high_m: (2,) upper corner.
        """
        rr, scene = self._rr, self._scene
        seen = zip(low_m.tolist(), high_m.tolist(), strict=True)
        (x0, x1), (y0, y1) = (
            known or of for known, of in zip((scene.x_range_m, scene.y_range_m), seen, strict=True)
        )
        corners = [(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)]
        sheet = rr.Mesh3D(
            vertex_positions=corners, triangle_indices=[(0, 1, 2), (0, 2, 3)], albedo_factor=_SURFACE
        )
        lines = [[(x, y0, _GRID_ABOVE_M), (x, y1, _GRID_ABOVE_M)] for x in _marks(x0, x1)]
        lines += [[(x0, y, _GRID_ABOVE_M), (x1, y, _GRID_ABOVE_M)] for y in _marks(y0, y1)]
        self._log(f"{WALL}/surface", sheet, static=True)
        self._log(f"{WALL}/grid", self._lines(lines, _GRID, 0.5), static=True)
        if scene.x_range_m or scene.y_range_m:
            edge = self._lines([[*corners, corners[0]]], _EDGE, 3.0)
            self._log(f"{WALL}/usable", edge, static=True)
        self._draw_directions(low_m, high_m)

    def _draw_directions(self, low_m: Array, high_m: Array) -> None:
        """Axes of the wall and gravity, at corners of what is seen."""
        rr = self._rr
        corner = (low_m[0] + _INSET_M, high_m[1] - _INSET_M, _ABOVE_M)
        axes = rr.Arrows3D(
            origins=[corner] * 2,
            vectors=[(0.2, 0, 0), (0, 0.2, 0)],
            colors=_AXES,
            radii=0.005,
            labels=["X", "Y"],
        )
        self._log(f"{WALL}/axes", axes, static=True)
        place = np.array([high_m[0] - _INSET_M, low_m[1] + _INSET_M, 0.1])
        gravity = rr.Arrows3D(
            origins=[solid_geometry.wall_rotation(self._scene.tilt_rad) @ place],
            vectors=[(0, 0, -0.25)],
            colors=[_WEIGHT],
            labels=["gravity"],
            radii=0.006,
        )
        self._log(f"{SCENE}/gravity", gravity, static=True)

    def path(self, name: str, points: Array, *, static: bool = False) -> None:
        """Draw a path (n, 2), wall frame, m."""
        strip = np.column_stack([points, np.full(len(points), _ABOVE_M)])
        colour = PATH_COLOURS.get(name, PATH_COLOURS["reference"])
        lines = self._lines([strip], colour, 1.0 if static else 2.0)
        self._stream.log(f"{WALL}/path/{name}", lines, static=static)

    def show(self, m: Moment) -> None:
        """Move robot, wheels, truth and reference; twice a second draw slip, loads, forces and ellipse."""
        rr, geometry = self._rr, self._scene.geometry
        for name, pose in (("estimate", m.pose), ("truth", m.truth), ("reference", m.reference)):
            if pose is not None:
                self._place(name, pose)
        turns = solid_geometry.wheel_turns(m.steering_rad, m.wheel_angle_rad, geometry)
        wheels = rr.InstancePoses3D(
            translations=solid_geometry.hub_places(geometry), quaternions=_xyzw(turns)
        )
        self._log(f"{ROBOT}/wheels", wheels)
        if not 0.0 <= m.t_s - self._explained_s < _EXPLAINED_S:
            self._explained_s = m.t_s
            self._explain_wheels(m)
            self._explain_forces(m)
            self._explain_estimate(m)

    def _explain_estimate(self, m: Moment) -> None:
        """Draw the 95 % ellipse of the estimated position."""
        if finite(m.covariance[:2, :2]):
            ellipse = solid_geometry.ellipse_in_body(m.covariance, float(m.pose[2]))
            self._log(f"{ROBOT}/covariance_95", self._lines([ellipse], PATH_COLOURS["estimate"], 2.0))

    def _explain_wheels(self, m: Moment) -> None:
        rr, geometry = self._rr, self._scene.geometry
        loads = [f"{n:.1f} N" for n in m.load_n]
        origins, vectors = solid_geometry.load_arrows(m.load_n, geometry)
        arrows = rr.Arrows3D(
            origins=origins, vectors=vectors, colors=[_LOAD], labels=loads, show_labels=False, radii=0.003
        )
        self._log(f"{ROBOT}/loads", arrows)
        if m.slip_m_s is None or not finite(m.slip_m_s):
            return
        slips = [f"{1e3 * math.hypot(*slip):.1f} mm/s" for slip in m.slip_m_s]
        origins, vectors = solid_geometry.slip_arrows(m.slip_m_s, m.steering_rad, geometry)
        arrows = rr.Arrows3D(
            origins=origins, vectors=vectors, colors=[_SLIP], labels=slips, show_labels=False, radii=0.003
        )
        self._log(f"{ROBOT}/slip", arrows)

    def _explain_forces(self, m: Moment) -> None:
        """Draw weight, fan and propellers; an arrow that pushes on the surface ends where it acts."""
        scene, rr = self._scene, self._rr
        weight = scene.robot.weight_n * solid_geometry.gravity_in_body(scene.tilt_rad, float(m.pose[2]))
        named = [("weight", np.array(scene.robot.centre_of_mass_m), weight, _WEIGHT)]
        named += [(f.name, f.place_m, f.force_n, _FORCE) for f in m.forces]
        vectors = [solid_geometry.ARROW_M_PER_N * force for _, _, force, _ in named]
        origins = [
            place - vector if vector[2] < -abs(vector[0]) else place
            for (_, place, _, _), vector in zip(named, vectors, strict=True)
        ]
        labels = [f"{name} {float(np.linalg.norm(force)):.0f} N" for name, _, force, _ in named]
        arrows = rr.Arrows3D(
            origins=origins,
            vectors=vectors,
            colors=[colour for *_, colour in named],
            labels=labels,
            show_labels=False,
            radii=0.004,
        )
        self._log(f"{ROBOT}/forces", arrows)

    def _draw_frames(self) -> None:
        rr = self._rr
        self._log(SCENE, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        tilted = rr.Transform3D(mat3x3=solid_geometry.wall_rotation(self._scene.tilt_rad))
        self._log(WALL, tilted, static=True)

    def _draw_robot(self) -> None:
        """Draw the parts that never move within the robot's frames."""
        rr, scene = self._rr, self._scene
        vertices, triangles, colours = robot_mesh.wheel_mesh(float(np.mean(scene.geometry.radius_m)))
        wheel = rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, vertex_colors=colours)
        self._log(f"{ROBOT}/wheels", wheel, static=True)
        for part in scene.mounted:
            w, *xyz = part.rotation_wxyz
            device = rr.Boxes3D(
                half_sizes=[(0.012, 0.018, 0.010)],
                centers=[part.position_m],
                quaternions=[(*xyz, w)],
                colors=[(31, 95, 168)],
                labels=[part.name],
                show_labels=False,
                fill_mode="solid",
            )
            self._log(f"{ROBOT}/devices/{part.name}", device, static=True)
        if scene.looks.mesh is None:
            self._draw_body()
        else:
            self._draw_mesh(scene.looks.mesh)

    def _draw_mesh(self, path: str) -> None:
        rr, looks = self._rr, self._scene.looks
        w, *xyz = looks.mesh_rotation_wxyz
        placed = rr.Transform3D(
            translation=looks.mesh_position_m, quaternion=(*xyz, w), scale=looks.mesh_unit_m
        )
        self._log(f"{ROBOT}/mesh", placed, static=True)
        self._log(f"{ROBOT}/mesh", rr.Asset3D(path=path), static=True)

    def _draw_body(self) -> None:
        rr, scene = self._rr, self._scene
        plate = rr.Boxes3D(
            sizes=[(*robot_mesh.plate_size(scene.geometry), robot_mesh.PLATE_THICKNESS_M)],
            centers=[(0.0, 0.0, robot_mesh.PLATE_HEIGHT_M)],
            colors=[robot_mesh.LIGHT],
            fill_mode="solid",
        )
        fan = rr.Cylinders3D(
            lengths=[_FAN_M[1]],
            radii=[_FAN_M[0]],
            colors=[robot_mesh.DARK],
            fill_mode="solid",
            centers=[(0.0, 0.0, robot_mesh.PLATE_HEIGHT_M + 0.5 * _FAN_M[1])],
        )
        tubes = robot_mesh.tubes(scene.robot, scene.geometry)
        frame = rr.LineStrips3D(
            [t.points for t in tubes], colors=[t.colour for t in tubes], radii=[t.radius_m for t in tubes]
        )
        for name, part in {"plate": plate, "fan": fan, "frame": frame}.items():
            self._log(f"{ROBOT}/body/{name}", part, static=True)

    def _place(self, name: str, pose: Array) -> None:
        """Move a frame; the first call for a frame also draws its outline, so that none is shown before."""
        rr = self._rr
        if name not in self._outlined:
            self._outlined.add(name)
            drawn = robot_mesh.outline(self._scene.robot)
            self._log(f"{WALL}/{name}/outline", self._lines([drawn], PATH_COLOURS[name], 1.5))
        w, x, y, z = quat_from_yaw(float(pose[2])).tolist()
        placed = rr.Transform3D(translation=solid_geometry.translation(pose), quaternion=(x, y, z, w))
        self._log(f"{WALL}/{name}", placed)

    def _log(self, entity: str, drawn: Any, *, static: bool = False) -> None:
        self._stream.log(entity, drawn, static=static)

    def _lines(self, strips: Sequence[Any], colour: Colour, width_px: float) -> Any:
        rr = self._rr
        return rr.LineStrips3D(strips, colors=[colour], radii=rr.Radius.ui_points(width_px))


def _xyzw(quaternions_wxyz: Array) -> Array:
    w, x, y, z = quaternions_wxyz.T
    return np.column_stack([x, y, z, w])


def _marks(low: float, high: float) -> Array:
    """Multiples of the grid's width between two bounds."""
    first, last = math.ceil(low / _GRID_M), math.floor(high / _GRID_M)
    return np.asarray(_GRID_M * np.arange(first, last + 1), dtype=np.float64)
