"""What the doctor can say about a sender."""

import dataclasses
import math
import re

import pytest
from following import follow

from hil.devices.tracker.mavlink.emulated_computer import IDEAL
from hil.devices.tracker.mavlink.emulated_links import WorldLink
from hil.devices.tracker.mavlink.odometry_messages import dialect

pytest.importorskip("pymavlink", reason="the extra mavlink is not installed")


def findings(bench, watch_s=2.0):
    bench.driver.open()
    samples = follow(bench, watch_s)
    return {f.check: f for f in bench.driver.findings(samples, watch_s)}


def test_a_healthy_sender_has_nothing_to_mend(mavlink_bench):
    options = dataclasses.replace(IDEAL, position_noise_m=0.002, angle_noise_rad=0.001)
    found = findings(mavlink_bench(options=options))
    assert {f.level for f in found.values()} == {"ok"}
    assert found["sender"].found == "system 1 component 197, sends heartbeats"
    assert found["time"].found == "round trip 0.60 ms, so known to 0.30 ms"
    assert found["rate"].found.startswith("100 poses per second, 0 packets lost")
    assert found["covariance"].found == "up to 2 mm and 0.057 deg"
    assert found["quality"].found == "90 %"
    assert "LOCAL_FRD" in found["frames"].found


@pytest.mark.parametrize(
    ("options", "check", "words"),
    [
        ({"sends_heartbeat": False}, "sender", "sends no heartbeat"),
        ({"answers_timesync": False}, "time", "answers no TIMESYNC.*20 ms older"),
        ({"network_s": 0.008}, "time", "round trip 16"),
        ({"sends_quality": False}, "quality", "not given"),
        ({"settle_s": (0.0, 60.0, 0.0)}, "quality", "10 %"),
        ({"frame": "LOCAL_FLU"}, "frames", "turn front-right-down axes"),
        ({"rate_hz": 20.0}, "rate", "20 poses per second"),
    ],
)
def test_what_is_missing_is_a_warning_with_a_remedy(mavlink_bench, options, check, words):
    found = findings(mavlink_bench(options=dataclasses.replace(IDEAL, **options)))
    assert found[check].level == "warning"
    assert re.search(words, found[check].found)
    assert found[check].remedy
    assert {f.check for f in found.values() if f.level != "ok"} == {check}


def test_covariances_that_are_not_given_are_said_to_be_so(mavlink_bench):
    found = findings(mavlink_bench(options=dataclasses.replace(IDEAL, sends_covariance=False)))
    assert found["covariance"].found.startswith("not given")


def test_saying_what_the_quaternion_turns_settles_the_doubt(mavlink_bench):
    options = dataclasses.replace(IDEAL, frame="LOCAL_FLU")
    found = findings(mavlink_bench(options=options, config={"body_axes": "FRD"}))
    assert found["frames"].level == "ok"


def test_a_failed_odometry_is_a_failure(mavlink_bench):
    found = findings(mavlink_bench("tracker:wrong,quality=-1"))
    assert found["quality"].level == "failure"


def test_losses_are_reported(mavlink_bench):
    found = findings(mavlink_bench("tracker:drop,probability=0.3"))
    assert found["rate"].level == "warning"


def test_a_sender_that_changes_its_frames_is_a_failure_with_a_remedy(by_hand):
    bench = by_hand()
    bench.send(frame_id=2)
    found = {f.check: f for f in bench.driver.findings()}
    assert found["frames"].level == "failure"
    assert found["frames"].remedy == "set the frames of the sender's odometry"


@pytest.mark.parametrize("asked", [math.nan, math.inf, -math.inf, 3e38])
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
