"""What the doctor can say about a sender."""

import dataclasses
import math

import pytest
from following import follow

from hil.fakes.tracker.mavlink.chip import IDEAL
from hil.fakes.tracker.mavlink.links import WorldLink
from hil.links.mavlink.messages import dialect

pytest.importorskip("pymavlink", reason="the extra mavlink is not installed")


def findings(bench, watch_s=2.0):
    bench.driver.open()
    samples = follow(bench, watch_s)
    return {f.check: f for f in bench.driver.findings(samples, watch_s)}


def test_a_healthy_sender_has_nothing_to_mend(mavlink_bench):
    options = dataclasses.replace(IDEAL, position_noise_m=0.002, angle_noise_rad=0.001)
    found = findings(mavlink_bench(options=options))
    assert {f.level for f in found.values()} == {"ok"}
    said = {"sender": "component 197", "time": "0.60 ms", "rate": "100 poses", "covariance": "2 mm"}
    for check, figure in {**said, "quality": "90 %", "frames": "LOCAL_FRD"}.items():
        assert figure in found[check].found


@pytest.mark.parametrize(
    ("options", "check"),
    [
        ({"sends_heartbeat": False}, "sender"),
        ({"answers_timesync": False}, "time"),
        ({"network_s": 0.008}, "time"),
        ({"settle_s": (0.0, 60.0, 0.0)}, "quality"),
        ({"frame": "LOCAL_FLU"}, "frames"),
        ({"rate_hz": 20.0}, "rate"),
    ],
)
def test_what_is_missing_is_a_warning_with_a_remedy(mavlink_bench, options, check):
    found = findings(mavlink_bench(options=dataclasses.replace(IDEAL, **options)))
    assert found[check].level == "warning"
    assert found[check].remedy
    assert {f.check for f in found.values() if f.level != "ok"} == {check}


def test_saying_what_the_quaternion_turns_settles_the_doubt(mavlink_bench):
    options = dataclasses.replace(IDEAL, frame="LOCAL_FLU")
    found = findings(mavlink_bench(options=options, config={"body_axes": "FRD"}))
    assert found["frames"].level == "ok"


def test_a_failed_odometry_is_a_failure(mavlink_bench):
    found = findings(mavlink_bench("tracker:wrong,quality=-1"))
    assert found["quality"].level == "failure"


def test_a_sender_that_changes_its_frames_is_a_failure_with_a_remedy(by_hand):
    bench = by_hand()
    bench.send(frame_id=2)
    found = {f.check: f for f in bench.driver.findings()}
    assert found["frames"].level == "failure"
    assert found["frames"].remedy


@pytest.mark.parametrize("asked", [math.nan, 3e38])
def test_a_request_for_a_message_that_is_none_is_not_answered(mavlink_bench, asked):
    """A client that asks for message NaN had ended the emulator."""
    common, bench = dialect(), mavlink_bench()
    bench.driver.open()
    mine = bench.computer.options.system_id, bench.computer.options.component_id
    request = common.MAVLink_command_long_message(
        *mine, common.MAV_CMD_REQUEST_MESSAGE, 0, asked, 0, 0, 0, 0, 0, 0
    )
    link = WorldLink(bench.computer)
    link.send(bytes(request.pack(common.MAVLink(None, srcSystem=255))), link.peer)
    assert follow(bench, 0.2)
