"""What the doctor says of a tracking camera: a remedy for what was measured, and for nothing else."""

from types import SimpleNamespace

import pytest

from hil.config.mavlink import MavlinkTrackerConfig
from hil.core.signals import Status
from hil.drivers.doctor_watch import Watched
from hil.drivers.tracker.kind import KIND, look


def reported(statuses):
    samples = [SimpleNamespace(status=status, confidence=3) for status in statuses]
    watched = Watched(KIND, MavlinkTrackerConfig(rate_hz=100.0), None, samples, 2.0, None, 100.0)
    return next(f for f in look(watched) if f.check == "samples")


@pytest.mark.parametrize("rate_hz", [92, 96, 100])
def test_a_sender_a_little_slower_than_written_is_well(rate_hz):
    assert reported([Status.OK] * 2 * rate_hz).level == "ok"


def test_a_sender_that_is_far_too_slow_is_reported_and_its_lenses_are_not_blamed():
    finding = reported([Status.OK] * 120)
    assert finding.level != "ok"
    assert "lens" not in finding.remedy
    assert "rate_hz" in finding.remedy


def test_poses_that_are_no_good_are_the_camera_s():
    finding = reported([Status.OK] * 120 + [Status.LOW_CONFIDENCE] * 80)
    assert finding.level != "ok"
    assert "lens" in finding.remedy
