"""Whatever the camera (or another program) sends, the driver gives samples or an error of ours."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.tracker import T265Config
from hil.core.errors import DeviceError
from hil.core.signals import Status
from hil.drivers.tracker.t265.driver import T265Tracker
from hil.drivers.tracker.t265.served_poses import FeedDevice, FeedFrame, FeedSensor
from hil.fakes.world import VirtualClock, World
from hil.links.t265_datagrams import FEED_INFO, FEED_MAGIC, INFO_RECORD, POSE_RECORD
from tests.selected import draws, every

INFO = INFO_RECORD.pack(FEED_MAGIC, FEED_INFO, b"Intel RealSense T265", b"0815", b"0.2.0.951")
DOUBLES = st.floats(allow_nan=True, allow_infinity=True)
POSES = st.builds(
    lambda number, stamp, values, confidence: POSE_RECORD.pack(
        FEED_MAGIC, 4, number, stamp, *values, confidence
    ),
    st.integers(0, 2**62),
    DOUBLES,
    st.lists(DOUBLES, min_size=13, max_size=13),
    st.integers(0, 255),
)


class Standing:
    """A plant that is not observed."""

    t_ns = 0

    def advance(self, t_ns):
        self.t_ns = t_ns


class Scripted:
    """A pipeline whose frames a test makes."""

    def resolve(self):
        return FeedSensor(lambda data: True)

    def start(self, config, callback):
        self.put = callback
        self.put(FeedFrame(POSE_RECORD.unpack(good_pose(1))))
        return FeedDevice(INFO)

    def stop(self):
        self.put = None


def good_pose(number):
    values = (0.001 * number, *[0.0] * 8, 1.0, *[0.0] * 3)
    return POSE_RECORD.pack(FEED_MAGIC, 4, number, 5.0 * number, *values, 3)


@draws(100)
@given(poses=st.lists(st.tuples(POSES, st.integers(0, 300_000_000)), max_size=12))
def test_poses_of_any_content_give_samples_or_a_device_error(poses):
    clock, pipeline = VirtualClock(World(Standing())), Scripted()
    driver = T265Tracker(T265Config(fail_after_s=1.0), clock, pipeline=pipeline)
    driver.open()
    for data, pause_ns in poses:
        pipeline.put(FeedFrame(POSE_RECORD.unpack(data)))
        clock.sleep_until_ns(clock.now_ns() + pause_ns)
        with contextlib.suppress(DeviceError):
            for s in driver.read():
                assert -(2**63) < s.stamp.t_ns <= s.stamp.host_ns + 100
                assert s.stamp.device_ns is None or abs(s.stamp.device_ns) < 2**63
                if s.status is Status.OK:
                    assert np.isfinite(s.position_m).all()
                    assert np.isfinite(s.quaternion_wxyz).all()
    driver.close()


@pytest.mark.parametrize(
    ("value", "place"), every(9, [(v, place) for v in (1.1e3, 1e12, -1e160, 1.7e308) for place in range(13)])
)
def test_a_finite_value_that_no_camera_can_mean_is_implausible(place, value):
    """Position, velocity, quaternion and turn rate alike; the poses beside it are used."""
    clock, pipeline = VirtualClock(World(Standing())), Scripted()
    driver = T265Tracker(T265Config(), clock, pipeline=pipeline)
    driver.open()
    record = list(POSE_RECORD.unpack(good_pose(2)))
    record[4 + place] = value
    for data in (POSE_RECORD.pack(*record), good_pose(3)):
        clock.sleep_until_ns(clock.now_ns() + 5_000_000)
        pipeline.put(FeedFrame(POSE_RECORD.unpack(data)))
    first, bad, good = driver.read()
    assert (first.status, bad.status, good.status) == (Status.OK, Status.IMPLAUSIBLE, Status.OK)
    assert np.isnan(bad.position_m).all()
    assert np.isnan(bad.velocity_m_s).all()
