"""A ready-made test module: watches a bench at rest for 15 s and judges every device.

In a project of your own, `tests/test_bench.py` needs one line::

    from hil.pytest_plugin.selfcheck import *

The servos are enabled where they stand, so that a robot on a wall holds itself; nothing is commanded
and nothing turns. `WATCH_S = 5.0` in the importing module makes it shorter. Which bench is watched is
said by `--bench`, as for every test.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hil.bench import Bench
from hil.config.bench import DEVICES
from hil.motion import Motion
from hil.pytest_plugin.selection import plainly, properties, source_of
from hil.signals import SERVOS, Status

__all__ = [
    "_told",
    "test_every_device_says_what_it_is",
    "test_gravity_and_rates_are_those_of_rest",
    "test_nothing_turns",
    "test_samples_come_at_their_rate_and_nearly_all_are_good",
    "test_samples_come_in_order_and_in_time",
    "test_steering_encoders_and_servos_agree",
    "test_supply_and_temperature_are_safe",
    "test_the_estimate_stays_where_it_is",
    "test_the_loop_keeps_its_rate",
    "test_the_supervisor_has_nothing_to_say",
    "watched",
]

WATCH_S = 15.0
GOOD_SHARE, RATE_SHARE = 0.98, 0.9
REST_RAD, REST_M, REST_HEADING_RAD = 0.02, 0.01, 0.02
SUPPLY_V, HOT_C = (10.0, 16.8), 70.0
GRAVITY_M_S2, GRAVITY_TOLERANCE_M_S2, REST_RAD_S = 9.81, 0.5, 0.05
LATE_SHARE = 0.01
AGE_S = {"servos": 0.02, "encoders": 0.05, "imu": 0.1, "tracker": 0.2, "mocap": 0.3}
HORN_RAD = 0.1


@dataclass(frozen=True)
class Watch:
    """A bench, and what it delivered at rest."""

    bench: Bench
    motion: Motion
    identity: dict[str, dict[str, str]]

    @property
    def duration_s(self) -> float:
        """Time watched, s."""
        return float(self.motion.t_s[-1])

    def samples(self, device: str) -> list[Any]:
        """All samples of a device in order; skips the test where the bench lacks the device."""
        if not self.bench.has(device):
            pytest.skip(f"bench {self.bench.config.name} has no {device}")
        return [sample for record in self.motion.records for sample in getattr(record.inputs, device)]


def expected_rate_hz(bench: Bench, device: str) -> float:
    """Rate at which a healthy device delivers, Hz."""
    loop_hz = bench.config.loop.rate_hz
    if device == "encoders" and bench.config.encoders is not None:
        return bench.config.encoders.rate_hz
    return {"servos": loop_hz, "imu": min(loop_hz, 90.0), "tracker": 190.0, "mocap": 90.0}[device]


def worst_status(sample: Any) -> Status:
    """OK where all of a sample can be used, else the first reason why not."""
    status = getattr(sample, "status", Status.OK)
    states = status if isinstance(status, tuple) else (status,)
    return next((s for s in states if s is not Status.OK), Status.OK)


@pytest.fixture(scope="module")
def watched(request: pytest.FixtureRequest) -> Watch:
    """The bench of the session, watched once for all tests of the module."""
    source = source_of(request.config)
    with plainly(), source.open() as bench:
        if bench.rig.servos is not None:
            bench.rig.servos.enable()
        identity = {d.name: dict(d.identity()) for d in bench.rig.devices()}
        motion = bench.observe(getattr(request.module, "WATCH_S", WATCH_S))
    return Watch(bench, motion, identity)


@pytest.fixture(autouse=True)
def _told(request: pytest.FixtureRequest) -> None:
    """Bench, calibration version and seed beside every result."""
    if "watched" in request.fixturenames:
        request.node.user_properties.extend(properties(source_of(request.config)))


each_device = pytest.mark.parametrize("device", DEVICES)


def test_every_device_says_what_it_is(watched: Watch) -> None:
    """Identity of each configured device, as read when it was opened."""
    for device in watched.bench.config.devices():
        assert watched.identity.get(device), f"{device} has not said what it is"


@each_device
def test_samples_come_at_their_rate_and_nearly_all_are_good(watched: Watch, device: str) -> None:
    """Rate and share of good samples; otherwise look at cables, supply and baud rate."""
    samples = [s for s in watched.samples(device) if worst_status(s) is not Status.STARTING]
    told = Counter(worst_status(s).value for s in samples)
    wanted = RATE_SHARE * expected_rate_hz(watched.bench, device) * watched.duration_s
    assert len(samples) >= wanted, f"{device}: {len(samples)} samples in {watched.duration_s:.1f} s"
    assert told["ok"] >= GOOD_SHARE * len(samples), f"{device}: {dict(told)}"


@each_device
def test_samples_come_in_order_and_in_time(watched: Watch, device: str) -> None:
    """Times of measurement increase and are not old; otherwise look at the USB latency timer or network."""
    good = [s for s in watched.samples(device) if worst_status(s) is Status.OK]
    assert good, f"{device} has not delivered a good sample"
    measured_ns = np.array([s.stamp.t_ns for s in good])
    assert np.all(np.diff(measured_ns) > 0), f"{device}: times of measurement go back"
    assert np.all(np.diff([s.stamp.seq for s in good]) >= 0), f"{device}: sequence numbers go back"
    age_s = np.array([s.stamp.host_ns for s in good]) * 1e-9 - measured_ns * 1e-9
    assert np.median(age_s) < AGE_S[device], f"{device}: samples are {np.median(age_s):.3f} s old"


def test_nothing_turns(watched: Watch) -> None:
    """Enabled servos hold their angles."""
    good = [s for s in watched.samples("servos") if s.ok]
    span_rad = np.ptp([s.position_rad for s in good], axis=0)
    moved = {SERVOS[i]: float(span_rad[i]) for i in range(8) if span_rad[i] > REST_RAD}
    assert not moved, f"turned at rest (rad): {moved}"


def test_supply_and_temperature_are_safe(watched: Watch) -> None:
    """Voltage and temperature as the servos report them."""
    watched.samples("servos")
    health = [h for record in watched.motion.records for h in record.inputs.health]
    assert health, "the servos have not told voltage and temperature"
    volts = np.array([h.voltage_v for h in health])
    celsius = np.array([h.temperature_c for h in health])
    low_v, high_v = SUPPLY_V
    assert low_v < np.nanmin(volts), f"supply down to {np.nanmin(volts):.1f} V"
    assert np.nanmax(volts) < high_v, f"supply up to {np.nanmax(volts):.1f} V"
    assert np.nanmax(celsius) < HOT_C, f"servos up to {np.nanmax(celsius):.0f} C"


def test_steering_encoders_and_servos_agree(watched: Watch) -> None:
    """Steering axes and servos show the same angles; otherwise a horn has slipped or a zero is wrong."""
    encoders = [s for s in watched.samples("encoders") if worst_status(s) is Status.OK]
    servos = [s for s in watched.samples("servos") if s.ok]
    horn_rad = np.median([s.angle_rad for s in encoders], axis=0)
    servo_rad = np.median([s.position_rad[4:] for s in servos], axis=0)
    apart_rad = np.abs((horn_rad - servo_rad + np.pi) % (2.0 * np.pi) - np.pi)
    assert np.all(apart_rad < HORN_RAD), f"steering axes FL, BL, BR, FR differ by {apart_rad} rad"


def test_gravity_and_rates_are_those_of_rest(watched: Watch) -> None:
    """The inertial unit feels gravity and no rotation; otherwise look at its axis remap and calibration."""
    good = [s for s in watched.samples("imu") if s.status is Status.OK]
    gravity_m_s2 = np.linalg.norm(np.mean([s.gravity_m_s2 for s in good], axis=0))
    rate_rad_s = np.linalg.norm(np.mean([s.gyro_rad_s for s in good], axis=0))
    assert abs(gravity_m_s2 - GRAVITY_M_S2) < GRAVITY_TOLERANCE_M_S2
    assert rate_rad_s < REST_RAD_S


def test_the_estimate_stays_where_it_is(watched: Watch) -> None:
    """Nothing drives the estimated pose of a robot at rest."""
    watched.samples("servos")
    estimate = watched.motion.estimate
    apart = np.abs(estimate - estimate[0]).max(axis=0)
    assert np.hypot(*apart[:2]) < REST_M, f"the estimate moved {1e3 * np.hypot(*apart[:2]):.1f} mm at rest"
    assert apart[2] < REST_HEADING_RAD


def test_the_loop_keeps_its_rate(watched: Watch) -> None:
    """Nearly no cycle starts late; otherwise the computer is too busy."""
    late, cycles = watched.bench.statistics.late, watched.bench.statistics.cycles
    assert late <= max(1, LATE_SHARE * cycles), f"{late} of {cycles} cycles were late"


def test_the_supervisor_has_nothing_to_say(watched: Watch) -> None:
    """No error events."""
    errors = [e.message for e in watched.motion.events if e.level == "error"]
    assert not errors
