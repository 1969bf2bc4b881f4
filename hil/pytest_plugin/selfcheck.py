"""A ready-made test module: observes a bench at rest for 15 s and tests every device.

In your own project, `tests/test_bench.py` needs one line::

    from hil.pytest_plugin.selfcheck import *

The servos are enabled at their current angles, so that a robot on a wall holds itself; nothing is commanded
and nothing turns. `WATCH_S = 5.0` in the importing module shortens the observation. `--bench` selects the
bench, as for every test. In real time an idle loop runs for a third of that time before and after: late
cycles are compared with its own, so that they show delays of the bench and not the load of the computer.
"""

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hil.bench import Bench, contract
from hil.bench.contract import BUSY_SHARE, due, oldest_s
from hil.bench.loop_settings import alignment_parameters
from hil.core.clock import nanoseconds
from hil.core.geometry import rotated
from hil.core.registry import kinds
from hil.core.signals import SERVOS, Status, worst
from hil.loop.driven_motion import Motion
from hil.loop.timing import LoopStatistics
from hil.procedure.bench_source import BenchSource
from hil.pytest_plugin.bench_selection import plainly, properties, source_of
from hil.robot.statics import GRAVITY_M_S2

__all__ = [
    "_bench_in_results",
    "test_every_device_says_what_it_is",
    "test_gravity_and_rates_are_those_of_rest",
    "test_gravity_points_where_the_bench_file_says",
    "test_nothing_turns",
    "test_samples_come_at_their_rate_and_nearly_all_are_good",
    "test_samples_come_in_order_and_in_time",
    "test_steering_encoders_and_servos_agree",
    "test_supply_and_temperature_are_safe",
    "test_the_estimate_stays_where_it_is",
    "test_the_loop_keeps_its_rate",
    "test_the_robot_is_left_held",
    "test_the_supervisor_has_nothing_to_say",
    "watched",
]

WATCH_S = 15.0
SETTLING_NS = nanoseconds(0.5)
"""Time at the start in which a camera may report low confidence."""
GOOD_SHARE, RATE_SHARE = 0.98, 0.85
REST_RAD, REST_M, REST_HEADING_RAD = 0.02, 0.01, 0.02
SUPPLY_V, HOT_C = (10.0, 16.8), 70.0
UPRIGHT_RAD = 0.15
GRAVITY_TOLERANCE_M_S2, REST_RAD_S = 0.5, 0.05
LATE_SHARE, IDLE_SHARE = 0.01, 1.0 / 3.0
HORN_RAD = 0.1


@dataclass(frozen=True)
class Watch:
    """A bench, its samples at rest, and the punctuality of idle loops before and after."""

    bench: Bench
    motion: Motion
    identity: dict[str, dict[str, str]]
    idle: tuple[LoopStatistics, ...] = ()

    @property
    def duration_s(self) -> float:
        """Observed time, s."""
        return float(self.motion.t_s[-1])

    def samples(self, device: str) -> list[Any]:
        """Return all samples of a device in order; skip the test if the bench lacks the device."""
        if not self.bench.has(device):
            pytest.skip(f"bench {self.bench.config.name} has no {device}")
        return [sample for record in self.motion.records for sample in record.inputs.of(device)]


@pytest.fixture(scope="module")
def watched(request: pytest.FixtureRequest) -> Watch:
    """The bench of the session, observed once for all tests of the module."""
    source, watch_s = source_of(request.config), float(getattr(request.module, "WATCH_S", WATCH_S))
    with plainly():
        idle = idle_for(source, watch_s * IDLE_SHARE)
        with source.open() as bench:
            bench.warns_not_held = False
            if bench.devices.servos is not None:
                bench.devices.servos.enable()
            identity = {d.name: dict(d.identity()) for d in bench.devices.devices()}
            motion = bench.observe(watch_s)
        idle += idle_for(source, watch_s * IDLE_SHARE)
    return Watch(bench, motion, identity, idle)


def idle_for(source: BenchSource, seconds: float) -> tuple[LoopStatistics, ...]:
    """Measure the punctuality of an idle loop at the bench's rate; empty in virtual time (never late)."""
    if source.virtual:
        return ()
    return (contract.idle_for(source.config, seconds),)


@pytest.fixture(autouse=True)
def _bench_in_results(request: pytest.FixtureRequest) -> None:
    """Add bench, calibration version and seed to every result."""
    if "watched" in request.fixturenames:
        request.node.user_properties.extend(properties(source_of(request.config)))


each_device = pytest.mark.parametrize("device", tuple(kinds()))


def settling(samples: Sequence[Any]) -> int:
    """Return how many samples at the start have low confidence as their only problem: a camera settles."""
    unsure = itertools.takewhile(
        lambda s: (
            worst(s) is Status.LOW_CONFIDENCE and s.stamp.host_ns - samples[0].stamp.host_ns < SETTLING_NS
        ),
        samples,
    )
    return sum(1 for _ in unsure)


def test_every_device_says_what_it_is(watched: Watch) -> None:
    """Each configured device reported its identity when it was opened."""
    for device in watched.bench.config.devices():
        assert watched.identity.get(device), f"{device} has not identified itself"


@each_device
def test_samples_come_at_their_rate_and_nearly_all_are_good(watched: Watch, device: str) -> None:
    """Rate and share of good samples; otherwise look at cables, supply and baud rate."""
    samples = [s for s in watched.samples(device) if worst(s) is not Status.STARTING]
    reported = Counter(worst(s).value for s in samples)
    wanted = RATE_SHARE * due(watched.bench, device, samples, watched.duration_s)
    assert len(samples) >= wanted, f"{device}: {len(samples)} samples in {watched.duration_s:.1f} s"
    assert reported["ok"] >= GOOD_SHARE * (len(samples) - settling(samples)), f"{device}: {dict(reported)}"


@each_device
def test_samples_come_in_order_and_in_time(watched: Watch, device: str) -> None:
    """Stamps increase, and samples are not old; otherwise look at the USB latency timer or network."""
    good = [s for s in watched.samples(device) if worst(s) is Status.OK]
    assert good, f"{device} has not delivered a good sample"
    measured_ns = np.array([s.stamp.t_ns for s in good])
    assert np.all(np.diff(measured_ns) > 0), f"{device}: times of measurement go back"
    assert np.all(np.diff([s.stamp.seq for s in good]) >= 0), f"{device}: sequence numbers go back"
    age_s = np.array([s.stamp.host_ns for s in good]) * 1e-9 - measured_ns * 1e-9
    limit_s = oldest_s(watched.bench.config, device)
    assert np.median(age_s) < limit_s, f"{device}: samples are {np.median(age_s):.3f} s old"


def test_nothing_turns(watched: Watch) -> None:
    """Enabled servos hold their angles."""
    good = [s for s in watched.samples("servos") if s.ok]
    span_rad = np.ptp([s.position_rad for s in good], axis=0)
    moved = {SERVOS[i]: float(span_rad[i]) for i in range(len(SERVOS)) if span_rad[i] > REST_RAD}
    assert not moved, f"turned at rest (rad): {moved}"


def test_supply_and_temperature_are_safe(watched: Watch) -> None:
    """Voltage and temperature that the servos report are within limits."""
    watched.samples("servos")
    health = [h for record in watched.motion.records for h in record.inputs.health]
    assert health, "the servos have not reported voltage and temperature"
    volts = np.array([h.voltage_v for h in health])
    celsius = np.array([h.temperature_c for h in health])
    low_v, high_v = SUPPLY_V
    assert low_v < np.nanmin(volts), f"supply down to {np.nanmin(volts):.1f} V"
    assert np.nanmax(volts) < high_v, f"supply up to {np.nanmax(volts):.1f} V"
    assert np.nanmax(celsius) < HOT_C, f"servos up to {np.nanmax(celsius):.0f} C"


def test_steering_encoders_and_servos_agree(watched: Watch) -> None:
    """Steering axes and servos show the same angles; otherwise a horn has slipped or a zero is wrong."""
    encoders = [s for s in watched.samples("encoders") if worst(s) is Status.OK]
    servos = [s for s in watched.samples("servos") if s.ok]
    horn_rad = np.median([s.angle_rad for s in encoders], axis=0)
    servo_rad = np.median([s.steer_rad for s in servos], axis=0)
    apart_rad = np.abs((horn_rad - servo_rad + np.pi) % (2.0 * np.pi) - np.pi)
    assert np.all(apart_rad < HORN_RAD), f"steering axes FL, BL, BR, FR differ by {apart_rad} rad"


def test_gravity_and_rates_are_those_of_rest(watched: Watch) -> None:
    """The inertial unit measures gravity, no rotation; otherwise look at its axis remap and calibration."""
    good = [s for s in watched.samples("imu") if s.status is Status.OK]
    gravity_m_s2 = np.linalg.norm(np.mean([s.gravity_m_s2 for s in good], axis=0))
    rate_rad_s = np.linalg.norm(np.mean([s.gyro_rad_s for s in good], axis=0))
    assert abs(gravity_m_s2 - GRAVITY_M_S2) < GRAVITY_TOLERANCE_M_S2
    assert rate_rad_s < REST_RAD_S


def test_gravity_points_where_the_bench_file_says(watched: Watch) -> None:
    """Measured gravity agrees with the surface's tilt and the robot's heading."""
    config = watched.bench.config
    good = [s for s in watched.samples("imu") if s.status is Status.OK]
    felt = np.mean([s.gravity_m_s2 for s in good], axis=0)
    mount = alignment_parameters(config).imu.rotation_wxyz
    up = np.array(rotated(mount, felt.tolist())) / np.linalg.norm(felt)
    tilt_rad, heading_rad = config.environment.tilt_rad, float(watched.motion.estimate[-1, 2])
    along = np.sin(tilt_rad)
    expected = np.array([along * np.cos(heading_rad), -along * np.sin(heading_rad), np.cos(tilt_rad)])
    apart_rad = float(np.arccos(np.clip(up @ expected, -1.0, 1.0)))
    assert apart_rad < UPRIGHT_RAD, (
        f"gravity is {np.degrees(apart_rad):.0f} deg from where tilt and heading have it; "
        "look at the unit's mount (imu.mount_rotation_wxyz) and at environment.tilt_rad"
    )


def test_the_estimate_stays_where_it_is(watched: Watch) -> None:
    """The estimated pose of a robot at rest does not drift."""
    watched.samples("servos")
    estimate = watched.motion.estimate
    apart = np.abs(estimate - estimate[0]).max(axis=0)
    assert np.hypot(*apart[:2]) < REST_M, f"the estimate moved {1e3 * np.hypot(*apart[:2]):.1f} mm at rest"
    assert apart[2] < REST_HEADING_RAD


def test_the_loop_keeps_its_rate(watched: Watch) -> None:
    """Hardly more cycles start late than in an idle loop; otherwise the bench's own work takes too long."""
    problem = too_late(watched.bench.statistics, watched.idle)
    if problem and worst_share(watched.idle) > BUSY_SHARE:
        pytest.skip(f"this computer is too busy for this check: {problem}")
    assert not problem, problem


def worst_share(idle: tuple[LoopStatistics, ...]) -> float:
    """Return the largest share of late cycles among idle loops; 0 without loops."""
    return max((one.late / one.cycles for one in idle if one.cycles), default=0.0)


def too_late(statistics: LoopStatistics, idle: tuple[LoopStatistics, ...]) -> str:
    """Return why a loop does not keep its rate; empty if it does.

    Args:
        statistics: statistics of the bench's loop.
        idle: statistics of idle loops around it; the worse one shows the load of the computer.
    """
    cycles = statistics.cycles
    excess = statistics.late - worst_share(idle) * cycles
    if excess <= max(1.0, LATE_SHARE * cycles):
        return ""
    beside = " and ".join(f"{one.late} of {one.cycles}" for one in idle) or "none"
    summary = statistics.summary()
    return (
        f"{statistics.late} of {cycles} cycles were late, {excess:.0f} more than an idle loop of this rate "
        f"before or after ({beside}) leads to expect, where {LATE_SHARE:.0%} more may be. "
        f"99th percentiles: work {summary.get('work_p99_ms', 0.0):.1f} ms, of it reading the devices "
        f"{summary.get('read_p99_ms', 0.0):.1f} ms. Look at USB latency, baud rates and prefetch; "
        "when another program began meanwhile, repeat"
    )


def test_the_robot_is_left_held(watched: Watch) -> None:
    """After closing, the bench reports HELD, or that no hold is needed."""
    held = watched.bench.held
    assert not held.lost, str(held)


def test_the_supervisor_has_nothing_to_say(watched: Watch) -> None:
    """The supervisor reports no error events."""
    errors = [e.message for e in watched.motion.events if e.level == "error"]
    assert not errors
