"""What was not measured is left out of a topic or marked as its definition asks; no message holds NaN."""

import dataclasses
import math

import numpy as np
import pytest
from mcap_cases import driving_record
from recorded import HEADER, messages, of_numbers, recorded

from hil.core.signals import AdhesionSample, Status

NAN3, NAN4, NAN8 = (np.full(n, math.nan) for n in (3, 4, 8))


def changed(record, **kinds):
    """A record whose samples of these kinds have these fields."""
    inputs = {
        kind: tuple(dataclasses.replace(sample, **fields) for sample in getattr(record.inputs, kind))
        for kind, fields in kinds.items()
    }
    return dataclasses.replace(record, inputs=dataclasses.replace(record.inputs, **inputs))


def lost(record):
    """A cycle in which nothing is known: no sample is good, nothing is estimated, the robot is stopped."""
    bad = {"status": Status.TIMEOUT}
    record = changed(
        record,
        servos={"position_rad": NAN8, "velocity_rad_s": NAN8, "current_a": NAN8},
        encoders={"angle_rad": NAN4},
        imu={
            "quaternion_wxyz": NAN4,
            "gyro_rad_s": NAN3,
            "linear_acceleration_m_s2": NAN3,
            "gravity_m_s2": NAN3,
            **bad,
        },
        tracker={"position_m": NAN3, "quaternion_wxyz": NAN4, **bad},
        mocap={"position_m": NAN3, "quaternion_wxyz": NAN4, **bad},
        adhesion={"speed_rpm": math.nan, "motor_a": math.nan, **bad},
        thrust={"throttle": math.nan, **bad},
        load_cells={"force_n": NAN3[:2]},
    )
    state = dataclasses.replace(
        record.state, pose_body_in_wall=NAN3, twist_body=NAN3, covariance=np.full((6, 6), math.nan)
    )
    return dataclasses.replace(record, state=state, reference=None)


def seen(tmp_path, *records):
    """Messages of a recording by topic; none holds a number that is not finite."""
    found = {}
    for topic, _, message in messages(recorded(tmp_path / "run.mcap", records, HEADER)):
        found.setdefault(topic, []).append(message)
        assert all(map(math.isfinite, of_numbers(message))), topic
    return found


def test_a_cycle_without_any_value_leaves_its_topics_empty(tmp_path):
    found = seen(tmp_path, driving_record(0), lost(driving_record(1)))
    assert len(found["/clock"]) == len(found["/hil/cycle"]) == 2
    measured = set(found) - {"/clock", "/hil/cycle", "/tf_static", "/robot_description", "/hil/events"}
    assert {topic: len(found[topic]) for topic in measured if topic != "/tracker/pose"} == dict.fromkeys(
        measured - {"/tracker/pose"}, 1
    )
    assert len(found["/tracker/pose"]) == len(driving_record(0).inputs.tracker)


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_an_imu_that_lacks_one_measurement_says_so_as_the_definition_asks(tmp_path, missing):
    """An IMU without attitude (status of its filter not good) still measures rates."""
    (fields,) = [{0: {"quaternion_wxyz": NAN4}, 1: {"gyro_rad_s": NAN3}, 2: {"gravity_m_s2": NAN3}}[missing]]
    (imu,) = seen(tmp_path, changed(driving_record(0), imu=fields))["/imu/data"]
    firsts = [
        imu.orientation_covariance[0],
        imu.angular_velocity_covariance[0],
        imu.linear_acceleration_covariance[0],
    ]
    assert firsts == [-1.0 if k == missing else 0.0 for k in range(3)]
    assert imu.orientation.w == 1.0
    assert imu.angular_velocity.x == (0.0 if missing == 1 else driving_record(0).inputs.imu[0].gyro_rad_s[0])


def test_a_joint_that_did_not_answer_is_left_out_and_a_column_that_nobody_has_is_empty(tmp_path):
    record = driving_record(0)
    servos = record.inputs.servos[0]
    position, angle = servos.position_rad.copy(), record.inputs.encoders[0].angle_rad.copy()
    position[2] = angle[3] = math.nan
    fan = AdhesionSample(servos.stamp, 21000.0, 0.7, math.nan, math.nan, 14.8, 40.0, math.nan)
    given = changed(record, servos={"position_rad": position}, encoders={"angle_rad": angle})
    given = dataclasses.replace(given, inputs=dataclasses.replace(given.inputs, adhesion=(fan,)))
    found = seen(tmp_path, record, given)
    whole, joints = found["/joint_states"]
    assert joints.name == [name for k, name in enumerate(whole.name) if k != 2]
    for column in ("position", "velocity", "effort"):
        np.testing.assert_array_equal(getattr(joints, column), np.delete(getattr(whole, column), 2))
    assert found["/steering_encoders"][1].name == whole.name[4:7]
    assert (found["/adhesion/fan"][1].name, len(found["/adhesion/fan"][1].effort)) == (["fan"], 0)
    assert len(found["/adhesion/fan"][1].velocity) == 1


def test_a_body_that_motion_capture_does_not_see_has_no_pose(tmp_path):
    """The capture system goes on sending the place where the body was lost."""
    found = seen(tmp_path, driving_record(0), changed(driving_record(1), mocap={"tracking_valid": False}))
    assert len(found["/mocap/pose"]) == 1
