"""Checks that position sensors (camera, motion capture) report no motion of a resting robot."""

import numpy as np

from hil.bench.contract.device_under_test import Broken, Subject, read_for
from hil.core.clock import NS_PER_S
from hil.core.registry import kinds

_WATCH_S, _FEWEST = 2.0, 20
MOST_M_S = 0.005
"""Cameras at rest drift by less than 1 mm/s; a released robot creeps down its wall faster than this."""


def sees_no_motion(subject: Subject) -> str:
    """The reported position of a robot at rest drifts by less than 5 mm/s."""
    kind = kinds()[subject.kind]
    if not (kind.motion_threshold and kind.measures_position):
        return "reports no position"
    with subject.opened() as device:
        samples = read_for(subject.bench, device, _WATCH_S)
    seen = [(s.stamp.t_ns, place) for s in samples if (place := kind.motion_value(s)) is not None]
    if len(seen) < _FEWEST:
        raise Broken(f"{len(seen)} usable places in {_WATCH_S:g} s", f"{_FEWEST}", "see `samples in time`")
    t_s = (np.array([t_ns for t_ns, _ in seen]) - seen[0][0]) / NS_PER_S
    drift = np.polyfit(t_s, np.array([place for _, place in seen]), 1)[0]
    speed_m_s = float(np.linalg.norm(drift))
    message = f"{1e3 * speed_m_s:.2g} mm/s"
    if speed_m_s > MOST_M_S:
        raise Broken(
            f"the reported position moves at {message}",
            f"at most {1e3 * MOST_M_S:g} mm/s while it stands",
            "have the robot stand still; clean the lenses, light the scene, look at markers and rigid body",
        )
    return message
