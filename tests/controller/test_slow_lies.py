"""Lies too slow for the sums: no drive ends, or stops, with sigmas that do not cover the truth."""

import numpy as np
import pytest

from hil.bench import open_bench
from hil.core.errors import HilError
from hil.robot.trajectories import line
from tests.selected import every

ORIGIN = np.zeros(3)
DRIVES = ("FL", "BL", "BR", "FR")


class Ride:
    """One drive: its events, how it ended, and by how much its error ever left three sigmas (m)."""

    def __init__(self, to, *faults, duration_s=20.0, seed=0, **settings):
        self.events, self.stop, self.uncovered_m, self.off_m = [], None, -1.0, 0.0
        way = line(ORIGIN, [*to, 0.0], duration_s=duration_s)
        with open_bench("emulated", seed=seed, faults=faults, overrides=settings) as self.bench:
            try:
                self.bench.drive(way, hold_s=0.3, start_pose=ORIGIN, on_cycle=self.look)
            except HilError as error:
                self.stop = error

    def look(self, record):
        self.events += record.events
        off_m = np.abs(self.bench.truth().pose_body_in_wall - record.state.pose_body_in_wall)[:2]
        sigma_m = np.sqrt(np.diag(record.state.covariance)[:2])
        self.off_m = float(off_m.max())
        self.uncovered_m = max(self.uncovered_m, float((off_m - 3.0 * sigma_m).max()))

    def reported(self, source, word):
        return [e for e in self.events if source in e.suspects and word in e.message]


ALL_SLIP = tuple(f"servo.drive_{wheel}:wrong@1.5,share=0.9" for wheel in DRIVES)
LIES = {
    "drives": ((0.0, 0.4), ALL_SLIP, "servos"),
    "camera short": ((0.6, 0.0), ("tracker:wrong@1.4,scale=0.94",), "tracker"),
    "camera long": ((0.6, 0.0), ("tracker:wrong@1.4,scale=1.05",), "tracker"),
}


@pytest.mark.parametrize("lie", every(3, LIES))
def test_a_slow_lie_is_named_covered_and_stops_the_robot(lie):
    to, faults, source = LIES[lie]
    ride = Ride(to, *faults, duration_s=12.0)
    assert ride.stop.reason == "sensors_disagree"
    assert ride.reported(source, "the estimate has gone")
    assert ride.off_m < 0.035
    assert ride.uncovered_m < 0.005


def test_a_camera_that_drifts_aside_is_reported_and_covered():
    ride = Ride((0.4, 0.0), "tracker:wrong@1.5,drift_y_m_s=0.002", duration_s=12.0)
    assert ride.reported("tracker", "aside")
    assert ride.off_m > 0.008
    assert ride.uncovered_m < 0.005


@pytest.mark.parametrize(
    ("share", "to"), every(4, [(share, to) for to in ((0.2, 0.0), (0.0, 0.2)) for share in (0.3, 0.5)])
)
def test_one_wheel_that_slips_is_named_within_half_a_second(share, to):
    ride = Ride(to, f"servo.drive_BR:wrong@2.5,share={share}", duration_s=6.0, mocap=None)
    (reported,) = ride.reported("servos", "wheel BR (drive_BR, ID ")
    assert 2.5 < reported.t_ns * 1e-9 < 3.0
    assert not any(f"wheel {other} (" in e.message for e in ride.events for other in ("FL", "BL", "FR"))
    assert ride.uncovered_m < 0.005


@pytest.mark.parametrize("plant", ["own", pytest.param("mujoco", marks=pytest.mark.long)])
@pytest.mark.parametrize("share", every(2, [1.0, 0.2]))
def test_an_honest_robot_calibrated_or_as_delivered_hears_nothing(plant, share):
    settings = {"emulation.plant": plant, "emulation.geometry_share": share}
    ride = Ride((0.2, 0.1), duration_s=6.0, seed=3, **settings)
    assert ride.events == []
    assert ride.stop is None
