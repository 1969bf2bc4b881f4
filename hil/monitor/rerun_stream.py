"""Sends cycle records to Rerun in batches: columns for the plots, shapes for the wall, the robot in space.

It lives in a process of its own (`hil.monitor.__main__`): neither the interpreter lock nor a stalled viewer,
for which Rerun may wait without an end, can delay the loop.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array
from hil.core.registry import further
from hil.core.signals import WHEELS, CycleRecord
from hil.monitor import plane_geometry, rerun_viewer, solid_geometry
from hil.monitor.plot_series import Series, SeriesCollector, conditions, finite
from hil.monitor.rerun_layout import PATH_COLOURS, Colour, Sight, blueprint, line_colours
from hil.monitor.robot_view import RobotView
from hil.monitor.rrd_file import PipedFile
from hil.monitor.scene import Scene
from hil.monitor.scene_state import Moments

_BATCH_NS = NS_PER_S // 10
_PLOTS_NS = NS_PER_S // 2
_TRAIL_NS = NS_PER_S
_FLUSH_S, _ABSENT_S, _FILE_S = 30.0, 1.0, 3.0
"""Time limits for the rest of the data: of viewers, of a viewer that does not listen, and of files."""
_VIEW_MARGIN_M = 0.45
_VIEW_SLACK_M = 0.25
_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR", "fatal": "CRITICAL"}
_OTHER_COLOUR = (120, 120, 60)


class RerunStream:
    """One Rerun recording with its outputs.

    Args:
        targets: any of `spawn`, `connect`, `serve`, a `rerun+http://` URL, or the name of a `.rrd`
            file; several at once are fed the same.
        scene: robot and surface.
        tab: name of the blueprint's front tab.
    """

    def __init__(self, targets: tuple[str, ...], scene: Scene, *, tab: str = "Motion") -> None:
        import rerun

        self._rr = rerun
        self._scene, self._tab = scene, tab
        self._server: subprocess.Popen[bytes] | None = None
        self._addresses: list[str] = []
        self._files: list[PipedFile] = []
        self._stream = rerun.RecordingStream("hil", send_properties=False)
        self._further = further(scene.devices)
        layout = blueprint(tab=tab, further=self._further)
        self._stream.set_sinks(*(self._sink(t) for t in targets), default_blueprint=layout)
        for file in self._files:
            file.opened()
        self._stream.send_blueprint(layout)
        self._extent: tuple[Array, Array] | None = None
        self._collector, self._moments = SeriesCollector(), Moments(scene)
        self._robot = RobotView(self._stream, scene)
        self._trails: dict[str, plane_geometry.Trail] = {}
        self._named: set[str] = set()
        self._conditions: dict[str, str] = {}
        self._latest: CycleRecord | None = None
        self._wheels: tuple[Array, Array] = (np.zeros(4), np.zeros(4))
        self._truth: Array | None = None
        self._sent_ns = self._plotted_ns = self._trails_ns = -(1 << 62)
        self._dropped = 0

    def _sink(self, target: str) -> Any:
        rr = self._rr
        if target == "spawn":
            rerun_viewer.spawn()
        elif target == "serve":
            self._server = rerun_viewer.serve()
            shown = (
                f"http://{rerun_viewer.HOST}:{rerun_viewer.WEB_PORT}?url={quote(rerun_viewer.url(), safe='')}"
            )
            print(f"rerun: open {shown} in a browser", file=sys.stderr)
        if target in rerun_viewer.LIVE or "://" in target:
            self._addresses.append(rerun_viewer.url() if target in rerun_viewer.LIVE else target)
            return rr.GrpcSink(self._addresses[-1])
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        self._files.append(PipedFile(Path(target)))
        return rr.FileSink(self._files[-1].entrance)

    def add(self, record: CycleRecord) -> None:
        """Take one cycle; per second of record time the views are updated ten times, the plots twice."""
        self._collector.add(record)
        self._latest = record
        if record.measurements.wheels:
            wheels = record.measurements.wheels[-1]
            self._wheels = (wheels.steering_rad, wheels.wheel_rate_rad_s)
        self._trail("estimate", record.state.pose_body_in_wall)
        if record.reference is not None:
            self._trail("reference", record.reference.pose_in_wall)
        for mocap in record.measurements.mocap:
            if mocap.valid:
                self._truth = mocap.pose
                self._trail("truth", mocap.pose)
        for name, state in record.observers.items():
            self._trail(name, state.pose_body_in_wall)
        for event in record.events:
            self._tell(record, f"{event.source}: {event.message}", _LEVELS.get(event.level, "WARN"))
        for name, wrong in conditions(record).items():
            if wrong != self._conditions.get(name, ""):
                self._tell(record, f"{name}: {wrong or 'good again'}", "WARN" if wrong else "INFO")
            self._conditions[name] = wrong
        self._moments.note(record)
        if not 0 <= record.inputs.t_ns - self._sent_ns < _BATCH_NS:
            self.flush()

    def path(self, points: Array) -> None:
        """Draw the path (n, 2) that the robot is going to follow, wall frame, m."""
        self._strip("path/planned", [points], PATH_COLOURS["reference"], 0.75, static=True)
        self._robot.path("planned", points, static=True)
        self._show_all(points)

    def dropped(self, total: int) -> None:
        """Show how many cycles the view has missed so far."""
        if total == self._dropped or self._latest is None:
            return
        self._tell(self._latest, f"monitor: {total} cycles not shown so far", "WARN")
        self._stream.log("monitor/dropped", self._rr.Scalars(total))
        self._dropped = total

    def flush(self) -> None:
        """Send the collected data: the views every time; plots less often, because each batch has a head."""
        record = self._latest
        if record is None:
            return
        self._sent_ns = record.inputs.t_ns
        if not 0 <= record.inputs.t_ns - self._plotted_ns < _PLOTS_NS:
            self._send_plots()
            self._plotted_ns = record.inputs.t_ns
        self._at(record)
        if finite(record.state.pose_body_in_wall):
            self._show_all(record.state.pose_body_in_wall[None, :2])
            self._send_robot(record)
            self._robot.show(self._moments.at(record, self._collector.seconds(record)))
        if not 0 <= record.inputs.t_ns - self._trails_ns < _TRAIL_NS:
            self._send_trails()
            self._trails_ns = record.inputs.t_ns

    def close(self) -> bool:
        """Send the rest and close the outputs; False if a viewer did not accept everything."""
        self.flush()
        self._send_plots()
        if self._latest is not None:
            self._send_trails()
        taken = True
        try:
            there = all(rerun_viewer.answers(address) for address in self._addresses)
            self._stream.flush(timeout_sec=_FLUSH_S if there else _ABSENT_S)
        except (RuntimeError, ValueError, OSError) as error:
            taken = False
            print(f"hil monitor: a viewer did not take everything ({error})", file=sys.stderr)
        if taken or self._files:  # else Rerun would only wait for the viewer once more
            self._stream.disconnect()
        for file in self._files:
            file.close(_FILE_S)
        if self._server is not None:
            rerun_viewer.stop(self._server)
        return taken

    def _tell(self, record: CycleRecord, text: str, level: str) -> None:
        self._at(record)
        self._stream.log("events", self._rr.TextLog(text, level=level))

    def _show_all(self, points: Array) -> None:
        """Widen the views so that the robot fits in everywhere on these points (n, 2), wall frame, m."""
        low, high = points.min(axis=0), points.max(axis=0)
        if self._extent is not None:
            known_low, known_high = self._extent
            if (low >= known_low - _VIEW_SLACK_M).all() and (high <= known_high + _VIEW_SLACK_M).all():
                return
            low, high = np.minimum(low, known_low), np.maximum(high, known_high)
        self._extent = (low, high)
        low, high = low - _VIEW_MARGIN_M, high + _VIEW_MARGIN_M
        (left, top), (right, bottom) = np.sort(plane_geometry.to_view(np.stack([low, high])), axis=0).tolist()
        self._robot.surface(low, high)
        tilt_rad = self._scene.tilt_rad
        eye, near = solid_geometry.overview(low, high, tilt_rad), solid_geometry.beside(tilt_rad)
        sight = Sight((left, right), (top, bottom), eye, near)
        self._stream.send_blueprint(blueprint(sight, self._tab, self._further))

    def _at(self, record: CycleRecord) -> None:
        self._stream.set_time("time", duration=self._collector.seconds(record))
        self._stream.set_time("cycle", sequence=record.cycle)

    def _trail(self, name: str, pose: Array) -> None:
        self._trails.setdefault(name, plane_geometry.Trail()).add(float(pose[0]), float(pose[1]))

    def _send_plots(self) -> None:
        for entity, series in self._collector.take():
            self._send_series(entity, series)

    def _send_series(self, entity: str, series: Series) -> None:
        rr = self._rr
        if entity not in self._named:
            self._named.add(entity)
            colours = line_colours(series.names, series.before)
            lines = rr.SeriesLines(names=list(series.names), colors=colours)
            self._stream.log(entity, lines, static=True)
        times = [rr.TimeColumn("time", duration=series.t_s), rr.TimeColumn("cycle", sequence=series.cycles)]
        values = series.values
        column = rr.Scalars.columns(scalars=values if values.shape[1] > 1 else values[:, 0])
        self._stream.send_columns(entity, indexes=times, columns=column)

    def _strip(
        self, entity: str, strips: list[Array], colour: Colour, width_px: float, *, static: bool = False
    ) -> None:
        rr = self._rr
        shown = [plane_geometry.to_view(s) for s in strips]
        radii = rr.Radius.ui_points(width_px)
        self._stream.log(
            f"wall/{entity}", rr.LineStrips2D(shown, colors=[colour], radii=radii), static=static
        )

    def _send_robot(self, record: CycleRecord) -> None:
        rr, geometry = self._rr, self._scene.geometry
        pose, colour = record.state.pose_body_in_wall, PATH_COLOURS["estimate"]
        steering_rad, rate_rad_s = self._wheels
        self._strip("robot/body", [plane_geometry.body_outline(pose, geometry)], colour, 1.5)
        if self._truth is not None:
            outline = plane_geometry.body_outline(self._truth, geometry)
            self._strip("robot/truth", [outline], PATH_COLOURS["truth"], 1.0)
        if finite(record.state.covariance[:2, :2]):
            ellipse = plane_geometry.covariance_ellipse(pose, record.state.covariance)
            self._strip("robot/covariance_95", [ellipse], colour, 0.75)
        self._send_observer_ellipses(record)
        if not (finite(steering_rad) and finite(rate_rad_s)):
            return
        wheels = plane_geometry.wheel_segments(pose, steering_rad, geometry)
        self._strip("robot/wheels", list(wheels), (40, 40, 40), 4.0)
        origins, vectors = plane_geometry.speed_arrows(pose, steering_rad, rate_rad_s, geometry)
        speeds = rate_rad_s * geometry.radius_m
        labels = [f"{w} {1000.0 * v:.0f} mm/s" for w, v in zip(WHEELS, speeds, strict=True)]
        arrows = rr.Arrows2D(
            origins=plane_geometry.to_view(origins),
            vectors=plane_geometry.to_view(vectors),
            labels=labels,
            colors=[(230, 60, 60)],
        )
        self._stream.log("wall/robot/speeds", arrows)

    def _send_observer_ellipses(self, record: CycleRecord) -> None:
        """Send covariance ellipses of the observers; not of odometry, whose covariance ignores slip."""
        for name, state in record.observers.items():
            pose, covariance = state.pose_body_in_wall, state.covariance
            if name != "odometry" and finite(covariance[:2, :2]) and finite(pose):
                ellipse = plane_geometry.covariance_ellipse(pose, covariance)
                self._strip(f"{name}/covariance_95", [ellipse], PATH_COLOURS.get(name, _OTHER_COLOUR), 0.75)

    def _send_trails(self) -> None:
        for name, trail in self._trails.items():
            points = trail.points()
            if len(points) > 1:
                self._strip(f"path/{name}", [points], PATH_COLOURS.get(name, _OTHER_COLOUR), 1.0)
                self._robot.path(name, points)
