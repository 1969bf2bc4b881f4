"""Bags of robots of any drive train: a twist takes the place of the joints, its slip factors are found."""

import json
import re
from dataclasses import replace

import numpy as np
import perfect_robot as perfect
import pytest
from perfect_robot import STORE
from rosbags.rosbag2 import StoragePlugin, Writer

import hil
from hil.cli import main
from hil.core.errors import ConfigError
from hil.core.signals import RobotState
from hil.datasets.topic_map import read_topic_map
from hil.datasets.twist_rows import wheels_of_twist
from hil.recording.runs import START_COVARIANCE, RecordedRun, RunStart
from hil.replay.estimator_comparison import compare_run
from hil.replay.recordings import open_recording
from hil.replay.truth_errors import errors
from hil.robot.kinematics import WheelGeometry, twist_of_vectors, wheel_vectors
from hil.robot.trajectories import line

TWIST, ODOMETRY = "geometry_msgs/msg/TwistWithCovarianceStamped", "nav_msgs/msg/Odometry"
TOPICS = """
schema = 2
[odometry]
topic = "/odom"
[truth]
topic = "/vicon"
"""


def message(kind, t_s, twist):
    kinds, none = STORE.types, np.zeros(36)
    vector = kinds["geometry_msgs/msg/Vector3"]
    x, y, turn = map(float, twist)
    own = kinds["geometry_msgs/msg/TwistWithCovariance"](
        kinds["geometry_msgs/msg/Twist"](vector(x, y, 0.0), vector(0.0, 0.0, turn)), none
    )
    if kind == TWIST:
        return kinds[TWIST](perfect.header(t_s), own)
    pose = kinds["geometry_msgs/msg/Pose"](
        kinds["geometry_msgs/msg/Point"](0.0, 0.0, 0.0),
        kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    return kinds[ODOMETRY](
        perfect.header(t_s), "base_link", kinds["geometry_msgs/msg/PoseWithCovariance"](pose, none), own
    )


def by_wheels(drive):
    """Twist (n, 3) since the row before, by the rates of wheels that nowhere contradict each other."""
    wheels = WheelGeometry.nominal()
    middle = 0.5 * (drive.delta[1:] + drive.delta[:-1])
    vectors = wheel_vectors(np.diff(drive.phi, axis=0) * wheels.radius_m, middle)
    twist = twist_of_vectors(wheels, vectors) / np.diff(drive.t_s)[:, None]
    return np.vstack([np.zeros(3), twist])


def write(folder, drive, twist, kind=ODOMETRY):
    """Bag of a drive with joints, a twist and the ground truth."""
    found = [*perfect.messages(drive)]
    found += [("/odom", t_s, message(kind, t_s, row)) for t_s, row in zip(drive.t_s, twist, strict=True)]
    kinds = {"/wheels": perfect.JOINT, "/vicon": perfect.POSE, "/odom": kind}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        lanes = {t: writer.add_connection(t, k, typestore=STORE) for t, k in kinds.items()}
        for topic, at_s, one in sorted(found, key=lambda m: m[1]):
            raw = STORE.serialize_cdr(one, kinds[topic])
            writer.write(lanes[topic], perfect.BEGIN_NS + round(at_s * 1e9), raw)
    return folder


@pytest.fixture(scope="module")
def drive():
    return perfect.drive()


@pytest.fixture(scope="module")
def bag(drive, tmp_path_factory):
    return write(tmp_path_factory.mktemp("bags") / "curve_1", drive, by_wheels(drive))


def mapping(folder, text=TOPICS):
    path = folder / "topics.toml"
    path.write_text(text)
    return path


def rmse_m(bag, topics, kinds=("odometry", "ekf", "ukf")):
    opened = open_recording(bag, topics=topics, bench="emulated_floor")
    motions = compare_run(opened.run(0), opened.bench, kinds, recorded=False)
    return {name: errors(motion)["rmse_position_m"] for name, motion in motions.items()}


@pytest.fixture(scope="module")
def climb():
    """Bench and records of a drive along both axes of an emulated wall."""
    with hil.open_bench("emulated", seed=5) as bench:
        start = bench.settle()
        corner, end = (start + np.array(way) for way in ((0.3, 0.0, 0.0), (0.3, 0.3, 0.0)))
        legs = [
            bench.drive(line(a, b, duration_s=8.0), feedback="ekf")
            for a, b in ((start, corner), (corner, end))
        ]
        return bench.model, legs


def reduced(climb, only, *, twist):
    """Position RMSE (m) of the filters over both legs, with some sensors, wheel-wise or by a twist."""
    model, legs = climb
    if twist:
        model = model.with_estimator(model.config.estimator.of_a_twist())
    squares = {}
    for leg in legs:
        records = [r for r in leg.records if len(r.measurements.wheels) == 1]
        wheels = [r.measurements.wheels[0] for r in records]
        t_s = np.array([w.stamp.t_ns for w in wheels]) * 1e-9
        phi, delta = (np.array([getattr(w, n) for w in wheels]) for n in ("wheel_angle_rad", "steering_rad"))
        vectors = wheel_vectors(
            np.diff(phi, axis=0) * model.geometry.radius_m,
            0.5 * (delta[1:] + delta[:-1]) - model.geometry.steering_zero_rad,
        )
        body = twist_of_vectors(model.geometry, vectors) / np.diff(t_s)[:, None]
        rows = wheels_of_twist(t_s, np.vstack([np.zeros(3), body]), model.geometry)
        cycles = []
        for record, own, row in zip(records, wheels, rows, strict=True):
            virtual = replace(own, wheel_angle_rad=row[:4], steering_rad=row[4:8], wheel_rate_rad_s=row[8:])
            absent = {name: () for name in ("gyro", "tracker") if name not in only}
            measured = replace(record.measurements, wheels=(virtual if twist else own,), **absent)
            cycles.append(replace(record, measurements=measured))
        start = RobotState(0, leg.mocap[np.isfinite(leg.mocap[:, 0])][0], np.zeros(3), START_COVARIANCE)
        start = replace(start, t_ns=cycles[0].measurements.t_ns)
        run = RecordedRun(RunStart(start, "odometry"), tuple(cycles))
        for name, motion in compare_run(run, model, ("ekf", "ukf"), recorded=False).items():
            squares.setdefault(name, []).append(errors(motion)["rmse_position_m"] ** 2)
    return {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}


@pytest.mark.parametrize("shape", ["differential", "sideways", "turns", "any"])
def test_the_wheels_give_the_twist_back(shape):
    """Also over reversals of direction, rests and turns on the spot."""
    t_s = np.arange(0.0, 12.0, 0.02)
    swing, turning = np.sin(t_s), 0.8 * np.sin(0.7 * t_s + 0.4)
    nothing = np.zeros_like(t_s)
    twist = {
        "differential": np.column_stack([0.3 * swing, nothing, turning]),
        "sideways": np.column_stack([nothing, 0.2 * swing, nothing]),
        "turns": np.column_stack([nothing, nothing, turning]),
        "any": np.column_stack([0.3 * swing, 0.2 * np.cos(1.3 * t_s), turning]),
    }[shape]
    twist[100:150] = 0.0
    wheels = WheelGeometry.nominal()
    rows = wheels_of_twist(t_s, twist, wheels)
    middle = 0.5 * (rows[1:, 4:8] + rows[:-1, 4:8])
    found = twist_of_vectors(wheels, wheel_vectors(np.diff(rows[:, :4], axis=0) * wheels.radius_m, middle))
    asked = twist[1:] * np.diff(t_s)[:, None]
    np.testing.assert_allclose(np.cumsum(found, axis=0), np.cumsum(asked, axis=0), atol=1e-3)


@pytest.mark.parametrize("only", [("wheels",), ("wheels", "gyro", "tracker")], ids=["alone", "all"])
def test_emulated_drives_reduced_to_a_twist(climb, only):
    """On a wall, where wheels slip and contradict each other: RMSE within a fifth of the wheel-wise one."""
    wheelwise, by_twist = (reduced(climb, only, twist=twist) for twist in (False, True))
    for name, error_m in by_twist.items():
        print(name, only, f"{1e3 * error_m:.2f} mm by a twist, {1e3 * wheelwise[name]:.2f} mm wheel-wise")
        assert error_m < 1.2 * wheelwise[name]


@pytest.mark.parametrize("kind", [ODOMETRY, TWIST])
def test_estimates_are_those_of_the_wheels(drive, tmp_path, kind):
    bag = write(tmp_path / "curve_1", drive, by_wheels(drive), kind)
    by_twist = rmse_m(bag, mapping(tmp_path))
    wheelwise = rmse_m(bag, mapping(tmp_path, perfect.MAPPING))
    for name, error_m in by_twist.items():
        assert error_m < max(1.2 * wheelwise[name], 1e-3)


def test_slip_factors_are_recovered(drive, tmp_path, capsys):
    """The odometry reports 4 % too far ahead and turns a fifth too much, as skid steering does."""
    noise = np.random.default_rng(3).normal(0.0, (2e-3, 2e-3, 5e-3), (len(drive.t_s), 3))
    bag = write(tmp_path / "curve_1", drive, by_wheels(drive) * (1.04, 1.0, 1.2) + noise)
    assert main(["replay", str(bag), "--topics", str(mapping(tmp_path)), "--estimator", "ekf", "--json"]) == 0
    slip = json.loads(capsys.readouterr().out)["slip"]
    assert slip["by"] == "ground truth"
    for axis, true in (("along", 1 / 1.04), ("turning", 1 / 1.2)):
        found = slip["factors"][axis]
        assert abs(found["factor"] - true) < 4.0 * found["sigma"]
        assert found["sigma"] < 0.01


def test_what_a_drive_does_not_determine_is_said(drive, tmp_path, capsys):
    still = replace(drive, pose=np.where([True, True, False], drive.pose, drive.pose[0]))
    ahead = by_wheels(drive) * (1.0, 0.0, 0.0)
    straight = np.cumsum(np.interp(drive.truth_s, drive.t_s, ahead[:, 0])) / 100.0
    c, s = np.cos(drive.pose[0, 2]), np.sin(drive.pose[0, 2])
    pose = np.column_stack([c * straight, s * straight, np.full(len(straight), drive.pose[0, 2])])
    noise = np.random.default_rng(4).normal(0.0, 2e-4, pose.shape)
    bag = write(tmp_path / "curve_1", replace(still, pose=pose + noise), ahead)
    main(["replay", str(bag), "--topics", str(mapping(tmp_path)), "--estimator", "odometry", "--json"])
    factors = json.loads(capsys.readouterr().out)["slip"]["factors"]
    assert factors["turning"] is None
    assert factors["across"] is None
    assert factors["along"]["factor"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        ((1e3, 1e3, 1.0), r"its way is 1e\+03 times that of the ground truth: look at its unit"),
        ((1.0, 1.0, -1.0), r"\[odometry\]: it turns against the ground truth"),
        ((1.0, 1.0, 57.3), r"\[odometry\]: it turns 57\.\d times as far as the ground truth"),
        ((-1.0, -1.0, 1.0), r"\[odometry\]: its way is turned by -?1[78]\d deg"),
    ],
)
def test_a_wrong_unit_or_axis_is_named(drive, tmp_path, capsys, spoil, said):
    bag = write(tmp_path / "curve_1", drive, by_wheels(drive) * spoil)
    line = ["replay", str(bag), "--topics", str(mapping(tmp_path)), "--estimator", "odometry", "--json"]
    assert main(line) == 2
    assert any(re.search(said, one) for one in json.loads(capsys.readouterr().out)["problems"])


def test_joints_and_a_twist_exclude_each_other(tmp_path):
    with pytest.raises(ConfigError) as caught:
        read_topic_map(mapping(tmp_path, perfect.MAPPING + '[odometry]\ntopic = "/odom"\n'))
    assert any("[wheels] and [odometry]" in problem for problem in caught.value.problems)
    with pytest.raises(ConfigError):
        read_topic_map(mapping(tmp_path, 'schema = 2\n[truth]\ntopic = "/vicon"\n'))


def test_there_are_no_wheels_to_calibrate(bag, tmp_path, capsys):
    assert main(["calibrate", str(bag), "--topics", str(mapping(tmp_path))]) == 2
    assert "a twist, and no wheels" in capsys.readouterr().err
    assert main(["twin", "compare", str(bag), "--topics", str(mapping(tmp_path))]) == 2
    assert "a twist cannot be compared" in capsys.readouterr().err
    assert main(["export", str(bag), "--topics", str(mapping(tmp_path))]) == 2
    assert "--trajectories" in capsys.readouterr().err
    assert main(["evaluate", str(bag), "--topics", str(mapping(tmp_path)), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean"]["rmse_position_m"] < 2e-3
