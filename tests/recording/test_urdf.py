"""The URDF of a bench: joints that take the servos' own angles, and frames that fit those of a recording."""

import math
import random
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from mcap_cases import driving_record
from recorded import messages, recorded
from scipy.spatial.transform import Rotation

from hil.bench.pipelines import BenchModel
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.signals import SERVOS, WHEELS, Inputs, ServoSample, Stamp, Status
from hil.loop.alignment import Alignment, AlignmentParameters
from hil.recording.urdf import urdf
from hil.robot.kinematics import WheelGeometry

CONFIG = load_bench("emulated")


def header(config=CONFIG, geometry=None):
    return BenchModel(config, geometry=geometry or WheelGeometry.nominal()).header()


def joints_of(text):
    return {joint.get("name"): joint for joint in Xml.fromstring(text).findall("joint")}


def numbers(element, attribute):
    return np.array([float(v) for v in element.get(attribute).split()])


def place_of(joint, angle_rad):
    """Origin and rotation of a joint's child in its parent, as the URDF specification has it."""
    origin = joint.find("origin")
    turn = Rotation.from_euler("xyz", numbers(origin, "rpy"))
    if joint.get("type") == "continuous":
        turn = turn * Rotation.from_rotvec(numbers(joint.find("axis"), "xyz") * angle_rad)
    return numbers(origin, "xyz"), turn


@pytest.mark.parametrize("seed", range(2))
def test_the_servos_own_angles_turn_the_wheels_as_the_bench_understands_them(seed):
    """Whatever signs, zeros and calibration: fork and tyre point where the loop says that the wheel does."""
    draw = random.Random(seed)
    aligned = {
        "drive_sign": [draw.choice((1, -1)) for _ in WHEELS],
        "steer_sign": [draw.choice((1, -1)) for _ in WHEELS],
        "steer_zero_rad": [draw.uniform(-1, 1) for _ in WHEELS],
    }
    overrides = {"servos.steer_limit_rad": 3.1, **{f"alignment.{k}": v for k, v in aligned.items()}}
    config = load_bench("emulated", overrides=overrides)
    nominal = WheelGeometry.nominal().vector()
    geometry = WheelGeometry.from_vector(nominal + [draw.uniform(-0.01, 0.01) for _ in nominal])
    raw = np.array([draw.uniform(-3, 3) for _ in SERVOS])
    sample = ServoSample(Stamp(0, 0, 0), raw, np.zeros(8), np.zeros(8), (Status.OK,) * 8, (0,) * 8)
    wheels = Alignment(AlignmentParameters(**aligned)).measure(Inputs(0, 0, servos=(sample,))).wheels[0]
    joints = joints_of(urdf(header(config, geometry)))
    for i, wheel in enumerate(WHEELS):
        place, fork = place_of(joints[f"steer_{wheel}"], raw[4 + i])
        np.testing.assert_allclose(place, [geometry.x_m[i], geometry.y_m[i], geometry.radius_m[i]], atol=1e-8)
        heading = wheels.steering_rad[i] - geometry.steering_zero_rad[i]
        np.testing.assert_allclose(
            fork.apply([1, 0, 0]), [math.cos(heading), math.sin(heading), 0], atol=1e-7
        )
        _, tyre = place_of(joints[f"drive_{wheel}"], raw[i])
        rolled = Rotation.from_rotvec([0, wheels.wheel_angle_rad[i], 0])
        assert (tyre.inv() * rolled).magnitude() == pytest.approx(0, abs=1e-7)


@pytest.mark.parametrize(
    "turn_wxyz", [(0.5, 0.5, -0.5, 0.5), (0.7071067811865476, 0.0, 0.7071067811865476, 0.0)]
)
def test_sensors_hang_where_they_are_mounted(turn_wxyz):
    config = load_bench("emulated", overrides={"imu.mount_rotation_wxyz": list(turn_wxyz)})
    _, turn = place_of(joints_of(urdf(header(config)))["imu_mount"], 0.0)
    w, x, y, z = turn_wxyz
    assert (turn.inv() * Rotation.from_quat([x, y, z, w])).magnitude() == pytest.approx(0, abs=1e-6)


def test_a_recording_carries_it_and_its_frames_join_the_recorded_tree(tmp_path, capsys):
    path = recorded(tmp_path / "run.mcap", map(driving_record, range(20)), header())
    parents, described, clocks, names = {}, [], [], set()
    for topic, log_ns, message in messages(path):
        if topic == "/robot_description":
            described.append(message.data)
        elif topic.startswith("/tf"):
            parents |= {t.child_frame_id: {t.header.frame_id} for t in message.transforms}
        elif topic == "/clock":
            clocks.append((message.clock.sec * 10**9 + message.clock.nanosec, log_ns))
        elif topic == "/joint_states":
            names |= set(message.name)
    assert len(described) == 1
    joints = joints_of(described[0])
    assert names == {name for name, joint in joints.items() if joint.get("type") == "continuous"}
    for joint in joints.values():
        parents.setdefault(joint.find("child").get("link"), set()).add(joint.find("parent").get("link"))
    assert {child: found for child, found in parents.items() if len(found) > 1} == {}
    links = {link.get("name") for link in Xml.fromstring(described[0]).findall("link")}
    assert links - set(parents) == set()
    assert len(clocks) == 20
    assert all(stamp == log_ns for stamp, log_ns in clocks)
    assert main(["robot", "urdf", "--bench", "emulated"]) == 0
    reported = joints_of(capsys.readouterr().out)
    assert set(reported) == set(joints)


def test_it_is_written_to_a_file_of_a_calibrated_robot(tmp_path, capsys):
    assert main(["robot", "urdf", "--out", str(tmp_path / "robot.urdf")]) == 0
    assert capsys.readouterr().out == ""
    assert Xml.parse(tmp_path / "robot.urdf").getroot().get("name") == "emulated"
    assert main(["robot", "urdf", "--out", str(tmp_path / "robot.urdf" / "robot.urdf")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_any_name_of_a_robot_is_one_in_xml():
    config = load_bench("emulated", overrides={"robot.name": 'Nr. 7 <"Käfer">'})
    assert Xml.fromstring(urdf(header(config))).get("name") == "Nr__7___K_fer__"
