"""A recording seen by other tools: one tree of frames, and stamps in the time of day."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_cases import PERIOD_NS, driving_record
from recorded import HEADER, STORE, messages, recorded
from rosbags.highlevel import AnyReader

from hil.config.loading import load_bench
from hil.core.clock import NS_PER_S, MonotonicClock, WallOffset
from hil.core.geometry import quat_from_yaw, quat_rotate
from hil.core.signals import WHEELS, Status
from hil.recording.mcap_reader import read_cycles, read_wall_offsets
from hil.recording.transform_tree import describe_clock

EPOCH_NS = 1_790_000_000 * NS_PER_S
OFFSET = WallOffset(EPOCH_NS, 300, 5)
CONFIG = load_bench("emulated")


def header(offset=OFFSET):
    return {**HEADER, "clock": describe_clock(offset)}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("frames") / "run.mcap"
    return recorded(path, map(driving_record, range(60)), header())


def stamp_ns(stamp):
    return stamp.sec * NS_PER_S + stamp.nanosec


def test_every_frame_that_a_message_names_hangs_on_the_wall(recording):
    parents, used = {}, set()
    for topic, _, message in messages(recording):
        if topic in ("/tf", "/tf_static"):
            for t in message.transforms:
                assert parents.setdefault(t.child_frame_id, t.header.frame_id) == t.header.frame_id
                q = t.transform.rotation
                assert np.linalg.norm([q.w, q.x, q.y, q.z]) == pytest.approx(1.0)
        elif hasattr(message, "header"):
            used |= {message.header.frame_id, getattr(message, "child_frame_id", "")} - {""}
    assert used == {"wall", "body", "imu", "tracker_start", "mocap"}
    for frame in used | set(parents):
        seen = [frame]
        while seen[-1] in parents:
            assert parents[seen[-1]] not in seen
            seen.append(parents[seen[-1]])
        assert seen[-1] == "wall"
    assert {f"wheel_{w}" for w in WHEELS} < set(parents)


def test_mounts_wheels_and_the_estimate_are_where_they_belong(recording):
    places = {}
    for topic, _, message in messages(recording):
        if topic in ("/tf", "/tf_static"):
            for t in message.transforms:
                v = t.transform.translation
                places[t.child_frame_id] = (v.x, v.y, v.z)
    assert places["imu"] == CONFIG.imu.mount_position_m
    assert places["tracker"] == CONFIG.tracker.mount_position_m
    assert places["wheel_BR"] == (-0.1125, -0.1125, 0.0254)
    x_m, y_m, _ = driving_record(59).state.pose_body_in_wall
    assert places["body"] == (x_m, y_m, 0.0)
    assert places["mocap"] == (0.0, 0.0, 0.0)


def test_the_cameras_poses_begin_at_the_estimated_camera_in_every_run(tmp_path):
    def seen_from(run, k, heading_rad, first):
        each = replace(driving_record(3 * run + k), cycle=k)
        camera = tuple(
            replace(s, quaternion_wxyz=quat_from_yaw(0.3), position_m=np.array([0.5, 0.2, 0.0]) + 0.01 * k)
            for s in each.inputs.tracker
        )
        if k == 0:  # not to be trusted yet
            camera = tuple(replace(s, status=Status.STARTING, position_m=np.full(3, np.nan)) for s in camera)
        state = replace(each.state, pose_body_in_wall=np.array([first, 0.0, heading_rad]))
        return replace(each, inputs=replace(each.inputs, tracker=camera), state=state)

    starts = ((0.1, 0.0), (-0.2, 0.7))
    runs = [seen_from(run, k, *starts[run]) for run in (0, 1) for k in range(3)]
    path = recorded(tmp_path / "run.mcap", runs, header())
    found = []
    for topic, _, message in messages(path):
        if topic == "/tf":
            found.append({t.child_frame_id: t.transform for t in message.transforms})
    assert ["tracker_start" in frames for frames in found] == [False, True, True] * 2
    mount = np.array(CONFIG.tracker.mount_position_m)
    for run, (heading_rad, x_m) in zip((found[:3], found[3:]), starts, strict=True):
        for k in (1, 2):
            t = run[k]["tracker_start"]
            q = np.array([t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z])
            origin = np.array([t.translation.x, t.translation.y, t.translation.z])
            seen = origin + quat_rotate(q, np.array([0.5, 0.2, 0.0]) + 0.01)
            there = np.array([x_m, 0.0, 0.0]) + quat_rotate(quat_from_yaw(heading_rad), mount)
            np.testing.assert_allclose(seen, there, atol=1e-12)


def test_a_record_without_an_estimate_moves_no_frame(tmp_path):
    lost = replace(driving_record(1).state, pose_body_in_wall=np.full(3, np.nan))
    records = [driving_record(0), replace(driving_record(1), state=lost)]
    path = recorded(tmp_path / "run.mcap", records, header())
    assert sum(topic == "/tf" for topic, _, _ in messages(path)) == 1


def test_who_listens_later_gets_the_fixed_frames_too(recording):
    """`ros2 bag play` offers them as they were: reliable, and the last one for late subscribers."""
    with AnyReader([recording], default_typestore=STORE) as bag:
        (fixed,) = (c for c in bag.connections if c.topic == "/tf_static")
        (profile,) = fixed.ext.offered_qos_profiles
    assert (profile.durability.name, profile.reliability.name) == ("TRANSIENT_LOCAL", "RELIABLE")
    assert (profile.history.name, profile.depth) == ("KEEP_LAST", 1)


def test_stamps_are_in_the_time_of_day_and_cycles_on_the_bench_clock(recording):
    for topic, log_ns, message in messages(recording):
        assert 0 <= log_ns - EPOCH_NS < NS_PER_S, topic
        heads = [t.header for t in message.transforms] if topic.startswith("/tf") else []
        heads += [message.header] if hasattr(message, "header") else []
        for head in heads:
            assert abs(stamp_ns(head.stamp) - log_ns) < 10 * PERIOD_NS
        if topic == "/hil/events":
            assert stamp_ns(message.stamp) == EPOCH_NS + 3 * PERIOD_NS
    assert [r.start_ns for r in read_cycles(recording)] == [driving_record(k).start_ns for k in range(60)]


def test_the_offset_is_kept_as_metadata_at_start_and_end(recording):
    start, end = read_wall_offsets(recording)
    assert start == OFFSET
    assert abs(end.offset_ns - MonotonicClock().wall_offset().offset_ns) < NS_PER_S
    with recording.open("rb") as stream:
        kept = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert kept["hil_clock_at_start"] == {
        "offset_ns": str(EPOCH_NS),
        "uncertainty_ns": "300",
        "measured_ns": "5",
    }


def test_virtual_time_has_no_offset_and_stays_the_same_bytes(tmp_path):
    paths = [
        recorded(tmp_path / n, map(driving_record, range(70)), header(None)) for n in ("a.mcap", "b.mcap")
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert read_wall_offsets(paths[0]) == ()
    assert max(log_ns for _, log_ns, _ in messages(paths[0])) < NS_PER_S


def test_the_offset_leads_from_the_monotonic_clock_to_the_time_of_day():
    clock = MonotonicClock()
    before_ns = time.time_ns()
    offset = clock.wall_offset()
    now_ns = clock.now_ns()
    after_ns = time.time_ns()
    assert 0 < offset.uncertainty_ns < 1_000_000
    assert before_ns - offset.uncertainty_ns <= now_ns + offset.offset_ns <= after_ns + offset.uncertainty_ns


def test_the_look_that_took_least_is_believed(monkeypatch):
    """One look is torn apart by a pause of 5 ms; of the others the narrowest counts."""
    times = iter([0, 5_000_900, 1_000, 1_300, 2_000, 2_040] + [3_000, 3_200] * 22)
    slow = SimpleNamespace(monotonic_ns=lambda: next(times), time_ns=lambda: EPOCH_NS)
    monkeypatch.setattr("hil.core.clock.time", slow)
    offset = MonotonicClock().wall_offset()
    assert offset == WallOffset(EPOCH_NS - 2_020, 21, 2_020)
