"""The three-dimensional view, read back from its file: things stand where their laws want them."""

from __future__ import annotations

import uuid
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rerun = pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
chunk = pytest.importorskip("rerun.chunk", reason="this version of Rerun cannot read its files")

from test_monitor_sink import shown  # noqa: E402

import hil  # noqa: E402
from hil.config.environment import EnvironmentConfig  # noqa: E402
from hil.config.loading import load_bench  # noqa: E402
from hil.core.geometry import Array, quat_rotate, rotation2  # noqa: E402
from hil.core.signals import CycleRecord, WheelMeasurement  # noqa: E402
from hil.monitor import Scene, solid_geometry  # noqa: E402
from hil.monitor.rerun_stream import RerunStream  # noqa: E402
from hil.recording.mcap_writer import McapRecorder  # noqa: E402
from hil.recording.runs import read_runs  # noqa: E402
from hil.robot.kinematics import WheelGeometry, inverse  # noqa: E402
from hil.robot.trajectories import line  # noqa: E402

GEOMETRY = WheelGeometry(
    np.array([0.11, -0.12, -0.11, 0.10]),
    np.array([0.12, 0.11, -0.10, -0.11]),
    np.full(4, 0.025),
    np.array([0.02, -0.01, 0.0, 0.03]),
)
ROBOT, TRUTH = "/scene/wall/estimate", "/scene/wall/truth"


def columns(piece: Any) -> dict[str, list[Any]]:
    """Columns of a piece of a file, without when they were written."""
    batch = piece.to_record_batch()
    return {n: batch.column(n).to_pylist() for n in batch.schema.names if not n.startswith("log_t")}


class Drawn:
    """What a file holds, by entity."""

    def __init__(self, path: Path) -> None:
        self._chunks = list(chunk.RrdReader(path).stream())
        self.entities = {c.entity_path for c in self._chunks}

    def rows(self, entity: str, component: str) -> dict[int | None, Any]:
        """Values of a component by cycle; None stands for a static one."""
        found: dict[int | None, Any] = {}
        for table in (columns(c) for c in self._chunks if c.entity_path == entity):
            name = next((n for n in table if n.endswith(component)), None)
            if name is not None:
                cycles = table.get("cycle", [None] * len(table[name]))
                found |= {c: np.array(v) for c, v in zip(cycles, table[name], strict=True) if v is not None}
        return found


def draw(path: Path, records: list[CycleRecord], scene: Scene | None = None) -> Drawn:
    stream = RerunStream((str(path),), scene or Scene(GEOMETRY))
    for record in records:
        stream.add(record)
    stream.close()
    return Drawn(path)


def turned(quaternion_xyzw: Array, vector: list[float]) -> Array:
    return quat_rotate(np.roll(quaternion_xyzw, 1), vector)


def steered(k: int, twist: Array) -> CycleRecord:
    """A robot with wheels as a twist wants them, anywhere on the wall."""
    record = shown(k)
    speed, steering = inverse(GEOMETRY, twist)
    stamp = record.measurements.wheels[0].stamp
    angle = speed / GEOMETRY.radius_m * k * 0.01
    wheels = WheelMeasurement(stamp, angle, speed / GEOMETRY.radius_m, steering, (True,) * 4)
    state = replace(record.state, pose_body_in_wall=np.array([0.4 + 0.01 * k, -0.2, 0.3]))
    measured = replace(record.measurements, wheels=(wheels,), mocap=())
    return replace(record, measurements=measured, state=state)


def test_every_wheel_stands_at_its_contact_and_rolls_where_the_contact_moves(tmp_path):
    """The wheels' frames and the kinematics of the steering angles are two ways to the same direction."""
    twist = np.array([0.03, 0.05, 0.4])
    drawn = draw(tmp_path / "run.rrd", [steered(k, twist) for k in range(0, 40, 10)])
    places = drawn.rows(f"{ROBOT}/wheels", "InstancePoses3D:translations")
    turns = drawn.rows(f"{ROBOT}/wheels", "InstancePoses3D:quaternions")
    at, rotation = drawn.rows(ROBOT, "Transform3D:translation"), drawn.rows(ROBOT, "Transform3D:quaternion")
    assert len(places) == 4
    moves_in_body = (GEOMETRY.projection() @ twist).reshape(4, 2)
    for cycle in places:
        pose = np.array([0.4 + 0.01 * cycle, -0.2, 0.3])
        centres = np.array([at[cycle][0] + turned(rotation[cycle][0], p) for p in places[cycle]])
        expected = np.column_stack([GEOMETRY.x_m, GEOMETRY.y_m]) @ rotation2(pose[2]).T + pose[:2]
        np.testing.assert_allclose(centres[:, :2], expected, atol=1e-6)
        np.testing.assert_allclose(centres[:, 2], GEOMETRY.radius_m, atol=1e-6)
        axles = np.array([turned(rotation[cycle][0], turned(q, [0.0, 1.0, 0.0])) for q in turns[cycle]])
        moves = moves_in_body @ rotation2(pose[2]).T
        rolls = np.cross(axles, [0.0, 0.0, 1.0])[:, :2]
        np.testing.assert_allclose(rolls, moves / np.linalg.norm(moves, axis=1)[:, None], atol=1e-6)


def test_a_wheel_turns_ahead_about_its_axle_by_what_was_measured(tmp_path):
    twist = np.array([0.05, 0.0, 0.0])
    drawn = draw(tmp_path / "run.rrd", [steered(k, twist) for k in (0, 10)])
    turns = drawn.rows(f"{ROBOT}/wheels", "InstancePoses3D:quaternions")
    tops = [turned(turns[cycle][0], [0.0, 0.0, 1.0]) for cycle in (0, 10)]
    angle = 0.05 / 0.025 * 0.1
    np.testing.assert_allclose(tops[0], [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(tops[1], [np.sin(angle), 0.0, np.cos(angle)], atol=1e-6)


def test_wheels_of_a_silent_servo_stay_as_they_were(tmp_path):
    before, after = steered(0, np.array([0.0, 0.05, 0.0])), steered(10, np.array([0.05, 0.0, 0.0]))
    (wheels,) = after.measurements.wheels
    nothing = np.full(4, np.nan)
    silent = replace(wheels, steering_rad=nothing, wheel_angle_rad=nothing)
    after = replace(after, measurements=replace(after.measurements, wheels=(silent,)))
    drawn = draw(tmp_path / "run.rrd", [before, after])
    turns = drawn.rows(f"{ROBOT}/wheels", "InstancePoses3D:quaternions")
    np.testing.assert_array_equal(turns[0], turns[10])


@pytest.fixture(scope="module")
def climbed(tmp_path_factory) -> tuple[Drawn, list[CycleRecord]]:
    """A short climb in the emulated world, recorded, and drawn from the recording."""
    folder = tmp_path_factory.mktemp("climb")
    overrides = {"emulation.randomise_truth": False, "environment.x_range_m": [-0.5, 2.0]}
    with hil.open_bench("emulated", seed=3, overrides=overrides) as bench:
        scene = Scene.of(bench.config, bench.geometry)
        bench.add_sink(McapRecorder(folder / "run.mcap", bench.header(), lossless=True))
        bench.drive(line((0, 0, 0), (0.04, 0, 0), duration_s=2.0), hold_s=0.0)
    records = list(list(read_runs(folder / "run.mcap"))[-1].records)
    return draw(folder / "run.rrd", records, scene), records


def test_the_drawn_truth_is_the_recorded_truth_of_the_emulated_robot(climbed):
    drawn, records = climbed
    truths = {r.cycle: r.truth["pose_body_in_wall"] for r in records if r.truth is not None}
    assert len(truths) == len(records)
    places, turns = (drawn.rows(TRUTH, f"Transform3D:{c}") for c in ("translation", "quaternion"))
    assert len(places) > 15
    assert np.ptp([truths[c][0] for c in places]) > 0.03
    for cycle, place in places.items():
        x, y, theta = truths[cycle]
        np.testing.assert_allclose(place[0], [x, y, 0.0], atol=1e-6)
        np.testing.assert_allclose(
            turned(turns[cycle][0], [1, 0, 0]), [np.cos(theta), np.sin(theta), 0], atol=1e-6
        )


def test_loads_and_slip_are_the_emulated_robots_own(climbed):
    drawn, records = climbed
    truths = {r.cycle: r.truth for r in records}
    loads = drawn.rows(f"{ROBOT}/loads", "Arrows3D:vectors")
    slips = drawn.rows(f"{ROBOT}/slip", "Arrows3D:vectors")
    assert len(loads) >= 3
    for cycle, arrows in loads.items():
        expected = solid_geometry.ARROW_M_PER_N * truths[cycle]["normal_load_n"]
        np.testing.assert_allclose(arrows[:, 2], expected, rtol=1e-5)
        length = np.linalg.norm(slips[cycle], axis=1)
        expected = solid_geometry.ARROW_S * np.linalg.norm(truths[cycle]["slip_m_s"], axis=1)
        np.testing.assert_allclose(length, expected, atol=1e-6)


def test_slip_seen_from_outside_and_loads_by_statics_are_near_the_emulated_robots(tmp_path, climbed):
    """A real robot has neither: they follow from motion capture, and from masses and the fan's force."""
    _, records = climbed
    unknown = [replace(r, truth=None) for r in records]
    scene = Scene.of(load_bench("emulated"), WheelGeometry.nominal())
    seen = draw(tmp_path / "run.rrd", unknown, scene)
    cycle = 150
    truth = records[cycle].truth
    assert truth is not None
    slip = seen.rows(f"{ROBOT}/slip", "Arrows3D:vectors")[cycle] / solid_geometry.ARROW_S
    expected = np.mean([r.truth["slip_m_s"] for r in records[cycle - 50 : cycle]], axis=0)
    assert np.linalg.norm(expected[:, 0]) > 1e-3
    np.testing.assert_allclose(slip[:, 0], expected[:, 0], atol=4e-4)
    loads = seen.rows(f"{ROBOT}/loads", "Arrows3D:vectors")[cycle][:, 2] / solid_geometry.ARROW_M_PER_N
    np.testing.assert_allclose(loads, truth["normal_load_n"], rtol=0.02)


def test_the_tree_hangs_together_and_up_the_wall_is_up(climbed):
    drawn, _ = climbed
    rotation = drawn.rows("/scene/wall", "Transform3D:mat3x3")[None].reshape(3, 3).T
    np.testing.assert_allclose(rotation @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(rotation @ [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], atol=1e-6)
    assert "/scene/wall/usable" in drawn.entities
    for frame in (ROBOT, TRUTH, "/scene/wall/reference"):
        assert drawn.rows(frame, "Transform3D:translation"), frame
        assert drawn.rows(f"{frame}/outline", "LineStrips3D:strips"), frame
    in_space = {e for e in drawn.entities if e.startswith("/scene/")}
    frames = ("/scene/wall/", "/scene/gravity")
    assert {e for e in in_space if not e.startswith(frames)} <= {"/scene/wall"}


def test_the_file_opens_on_the_robot_in_space(tmp_path):
    """What the blueprint has in front: the first tab of the first group, a view of the class 3D."""
    path = tmp_path / "run.rrd"
    draw(path, [shown(k) for k in range(20)])
    reader = chunk.RrdReader(path)
    entries = reader.blueprints()
    assert entries
    for entry in entries:
        front = in_front(reader.stream(store=entry))
        assert front["class_identifier"] == ["3D"]
        assert front["display_name"][0].startswith("Robot")
        assert front["space_origin"] == ["/scene"]


def in_front(blueprint: Any) -> dict[str, Any]:
    """The view that a blueprint has in front: of groups the first, of tabs the active one."""
    values: dict[str, dict[str, Any]] = {}
    for piece in blueprint:
        known = values.setdefault(piece.entity_path, {})
        known |= {n.rpartition(":")[2]: v[-1] for n, v in columns(piece).items() if v}
    (root,) = values["/viewport"]["root_container"]
    entity = f"/container/{uuid.UUID(bytes=bytes(root))}"
    while entity.startswith("/container"):
        inner = values[entity]["contents"]
        active = values[entity].get("active_tab")
        entity = "/" + (active or inner)[0].lstrip("/")
    return values[entity]


@pytest.mark.parametrize(("tilt_rad", "pushed"), [(np.pi / 2, True), (0.0, False)])
def test_fan_and_propellers_push_on_a_wall_only_and_weight_points_down(tmp_path, tilt_rad, pushed):
    environment = EnvironmentConfig(tilt_rad=tilt_rad)
    scene = Scene(GEOMETRY, environment=environment)
    drawn = draw(tmp_path / "run.rrd", [steered(0, np.zeros(3))], scene)
    labels = drawn.rows(f"{ROBOT}/forces", "Arrows3D:labels")[0]
    vectors = drawn.rows(f"{ROBOT}/forces", "Arrows3D:vectors")[0]
    assert list(labels[:1]) == ["weight 32 N"]
    assert any("fan (assumed) 45 N" in label for label in labels) is pushed
    in_wall = np.array([*(rotation2(0.3) @ vectors[0][:2]), vectors[0][2]])
    in_scene = solid_geometry.wall_rotation(tilt_rad) @ in_wall
    weight_n = scene.robot.mass_kg * 9.81
    np.testing.assert_allclose(in_scene, [0, 0, -solid_geometry.ARROW_M_PER_N * weight_n], atol=1e-6)
