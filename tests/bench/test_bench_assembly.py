"""`open_bench`: the same devices and loop in virtual time, at the wire and mixed; a seed decides all."""

import hashlib
import math
import pickle

import numpy as np
import pytest

import hil
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, FaultNotSupportedError, TrajectoryError, UsageError
from hil.robot.trajectories import line
from tests.patience import FANLESS, PATIENT

pytestmark = pytest.mark.usefixtures("warm_commands")

STRAIGHT = line((0.0, 0.0, 0.0), (0.06, 0.0, 0.0), duration_s=1.5)


@pytest.fixture(scope="module")
def first():
    """The drive of the first seed."""
    return drive(1)


def drive(seed, overrides=None, **options):
    overrides = {**FANLESS, **(overrides or {})}
    with hil.open_bench("emulated", seed=seed, overrides=overrides, **options) as bench:
        return bench.drive(STRAIGHT, hold_s=0.2)


def log_hash(motion):
    """Of everything that the devices sent and received; the loop's own timing is the host's."""
    reported = [(r.inputs, r.setpoint, r.state.pose_body_in_wall.tobytes()) for r in motion.records]
    return hashlib.sha256(pickle.dumps(reported)).hexdigest()


LATE = ("good samples a second", "old or more when they arrive", "stale for", "answers again")
"""What a bench says of samples that come late: the emulator shares this computer, which may be busy."""


def test_a_seed_decides_every_bit_of_a_run(first):
    again, other = drive(1), drive(2)
    assert log_hash(first) == log_hash(again)
    assert log_hash(first) != log_hash(other)


def asks_ahead(realtime=False, **overrides):
    """What a bench decides, seen in its configuration; nothing is opened."""
    return load_bench("emulated", overrides=overrides).settled(realtime=realtime).servos.prefetch


def test_servos_are_asked_ahead_in_real_time_and_at_rates_that_need_it():
    real = {f"{name}.backend": "real" for name in ("servos", "encoders", "imu", "tracker", "mocap")}
    real["imu.port"] = "/dev/ttyUSB1"
    assert asks_ahead() is False
    assert asks_ahead(**{"loop.rate_hz": 200.0}) is False
    assert asks_ahead(realtime=True) is True
    assert asks_ahead(**real) is True
    assert asks_ahead(**real, **{"loop.rate_hz": 50.0}) is False
    assert asks_ahead(**real, **{"servos.prefetch": False}) is False
    assert asks_ahead(**{"servos.prefetch": True}) is True


def test_a_run_that_asks_ahead_repeats_bit_for_bit():
    first, again = (drive(1, overrides={"servos.prefetch": True, "loop.rate_hz": 100.0}) for _ in range(2))
    assert log_hash(first) == log_hash(again)
    ages_ns = [s.stamp.host_ns - s.stamp.t_ns for r in first.records[2:] for s in r.inputs.servos]
    assert 8_000_000 < min(ages_ns) <= max(ages_ns) < 10_000_000


def test_true_imperfections_come_from_the_configuration(first):
    adversary = drive(1, overrides={"emulation.tracker": {"scale_sigma": 0.02}})
    assert log_hash(first) != log_hash(adversary)
    with pytest.raises(ConfigError, match=r"tracker\.scale_sigmma: unknown; did you mean scale_sigma"):
        hil.open_bench("emulated", overrides={"emulation.tracker": {"scale_sigmma": 0.2}})


def test_faults_need_an_emulated_device_that_can_produce_them():
    with pytest.raises(FaultNotSupportedError, match="imu of sensors is real"):
        hil.open_bench("sensors", faults=("imu:stuck",))
    with pytest.raises(FaultNotSupportedError, match="imu cannot produce"):
        hil.open_bench("emulated", faults=("imu:bus_off",))
    with pytest.raises(FaultNotSupportedError, match="no emulated device of that name"):
        hil.open_bench("emulated", faults=("camera:off",))


def test_a_fault_timeline_acts_like_the_specs(tmp_path):
    timeline = tmp_path / "faults.toml"
    timeline.write_text('[[fault]]\ndevice = "tracker"\nkind = "off"\nat_s = 1.0\nduration_s = 0.5\n')
    given = [{"faults": (fault,)} for fault in ("tracker:off@1+0.5", str(timeline))]
    given.append({"overrides": {"emulation.faults": [str(timeline)]}})
    by_spec, by_file, by_bench_file = (hil.open_bench("emulated", **one).faults for one in given)
    assert by_spec == by_file == by_bench_file
    timeline.write_text('[[fault]]\ndevice = "tracker"\nkind = "off"\nat = 1.0\n[[fault]]\nkind = 3\n')
    with pytest.raises(
        ConfigError, match=r"(?s)faults\.toml: not a fault timeline.*fault\.0\.at: .*fault\.1"
    ):
        hil.open_bench("emulated", faults=(str(timeline),))
    with pytest.raises(UsageError, match=r"^emulated: emulation\.faults: .*period_s is 0"):
        hil.open_bench("emulated", overrides={"emulation.faults": ["imu:intermittent,period_s=0"]})


def test_a_fault_of_the_bench_file_is_refused_by_its_key_and_one_of_the_call_is_not():
    overrides = {"emulation.faults": ["imu:bus_off"]}
    with pytest.raises(FaultNotSupportedError, match=r"^emulated: emulation\.faults: imu cannot produce"):
        hil.open_bench("emulated", overrides=overrides)
    with pytest.raises(FaultNotSupportedError, match=r"^imu cannot produce"):
        hil.open_bench("emulated", faults=("imu:bus_off",))


def test_what_the_limits_cannot_follow_is_refused_before_anything_moves():
    with hil.open_bench("emulated", seed=1, overrides={"environment.x_range_m": [-1.0, 1.0]}) as bench:
        before = bench.clock.now_ns()
        with pytest.raises(TrajectoryError, match="x"):
            bench.drive(line((0.0, 0.0, 0.0), (1.5, 0.0, 0.0), duration_s=30.0))
        with pytest.raises(TrajectoryError, match="speed"):
            bench.drive(line((0.0, 0.0, 0.0), (0.9, 0.0, 0.0), duration_s=12.0))
        with pytest.raises(UsageError, match="feedback"):
            bench.drive(STRAIGHT, feedback="hope")
        with pytest.raises(UsageError, match="controller"):
            bench.drive(STRAIGHT, controller="hope")
        assert bench.clock.now_ns() == before


def test_the_same_drive_at_the_wire_in_real_time():
    with hil.open_bench("emulated", seed=1, realtime=True, overrides=PATIENT) as bench:
        assert bench.world is None
        assert bench.truth() is None
        motion = bench.drive(STRAIGHT, hold_s=0.5)
        measured = motion.mocap[np.isfinite(motion.mocap[:, 0])][-1]
        assert np.linalg.norm(motion.estimate[-1][:2] - measured[:2]) < 0.01
        said = [e.message for e in motion.events]
        assert [message for message in said if not any(late in message for late in LATE)] == []


def test_a_mix_of_real_and_emulated_devices(emulator, tmp_path):
    """To the bench, servos and mocap of another process are as real as hardware; the rest it emulates."""
    mixed = tmp_path / "mixed.toml"
    mixed.write_text(
        f"""schema = 1
name = "mixed"
[servos]
port = "{emulator["servos"]["port"]}"
baud = {emulator["servos"]["baud"]}
[mocap]
command_port = {emulator["mocap"]["command_port"]}
[imu]
[tracker]
[encoders]
"""
    )
    with hil.open_bench(mixed, emulate="imu,tracker,encoders", overrides=PATIENT) as bench:
        assert bench.config.emulated() == ("encoders", "imu", "tracker")
        motion = bench.drive(STRAIGHT, feedback="odometry", hold_s=0.3)
        assert np.linalg.norm(motion.mocap[np.isfinite(motion.mocap[:, 0])][-1][:2] - [0.06, 0.0]) < 0.02
        inputs = motion.records[-1].inputs
        assert inputs.servos
        assert any(r.inputs.imu for r in motion.records[-20:])
        assert any(r.inputs.tracker for r in motion.records[-20:])


@pytest.mark.parametrize("wrong", [-5, math.nan, "1"])
def test_times_that_are_none_are_refused_before_anything_moves(wrong):
    bench = hil.open_bench("emulated")
    bench.close()
    bench.close()  # twice or without entering, which is harmless
    with pytest.raises(UsageError, match=r"^hold_s is .*; expected a finite number of s, 0 or more$"):
        bench.drive(line((0, 0, 0), (0.05, 0, 0)), hold_s=wrong)
    with pytest.raises(UsageError, match=r"^duration_s is .*; expected a finite number of s, 0 or more$"):
        bench.observe(wrong)


@pytest.mark.parametrize("wrong", [-1, 1.5, True])
def test_a_seed_that_is_none_is_refused(wrong):
    with pytest.raises(UsageError, match=r"^seed is .*; expected a whole number, 0 or more$"):
        hil.open_bench(seed=wrong)
