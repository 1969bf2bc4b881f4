"""What every sensor promises, whoever answers on the wire."""

from types import SimpleNamespace

import numpy as np
import pytest

from hil.vocabulary.errors import DeviceError
from hil.vocabulary.kinds import kinds
from hil.vocabulary.signals import Status

ARRAYS = {
    "servos": {"position_rad": 8, "velocity_rad_s": 8, "current_a": 8},
    "encoders": {"angle_rad": 4},
    "imu": {
        "quaternion_wxyz": 4, "gyro_rad_s": 3, "linear_acceleration_m_s2": 3, "gravity_m_s2": 3,
    },
    "tracker": {"position_m": 3, "quaternion_wxyz": 4, "velocity_m_s": 3, "angular_velocity_rad_s": 3},
    "mocap": {"position_m": 3, "quaternion_wxyz": 4},
}  # fmt: skip
LEAST_SHARE, OPEN_RATE_HZ = 0.7, 100.0
"""Of the samples that are due: this computer's load may cost some. What is due where the owner chooses."""
WATCH_S = 1.0


def statuses(sample):
    status = getattr(sample, "status", Status.OK)
    return status if isinstance(status, tuple) else (status,)


def test_an_open_device_says_what_it_is_and_a_closed_one_says_nothing(device):
    identity = device.identity()
    assert identity
    assert all(isinstance(k, str) and isinstance(v, str) and v for k, v in identity.items())
    device.close()
    assert not device.identity()
    device.close()


def test_it_can_be_opened_again(device, collect):
    assert collect(device, 0.2)
    device.close()
    device.open()
    assert collect(device, 0.2)


def test_reading_a_closed_device_is_a_named_error(device):
    device.close()
    with pytest.raises(DeviceError, match=device.name):
        device.read()


@pytest.fixture(scope="module")
def already(bench):
    """What has been watched on this bench, by device."""
    return {}


@pytest.fixture
def watched(kind, bench, collect, already):
    """A device that was opened, read for a while and closed: its samples, and when it was read."""
    name = kind
    found = bench.rig.get(name)
    if found is None:
        pytest.skip(f"bench {bench.config.name} has no {name}")
    if name not in already:
        found.open()
        began_ns = bench.clock.now_ns()
        samples = collect(found, WATCH_S)
        ended_ns = bench.clock.now_ns()
        found.close()
        rate_hz = kinds()[name].rate_hz(bench.config.devices()[name], bench.config.loop.rate_hz)
        already[name] = SimpleNamespace(
            name=name, samples=samples, began_ns=began_ns, ended_ns=ended_ns, rate_hz=rate_hz
        )
    return already[name]


def test_samples_arrive_in_order_with_stamps_that_make_sense(watched):
    good = [s for s in watched.samples if all(x is Status.OK for x in statuses(s))]
    rate_hz = OPEN_RATE_HZ if np.isnan(watched.rate_hz) else watched.rate_hz
    assert len(good) >= LEAST_SHARE * rate_hz * WATCH_S
    measured = [s.stamp.t_ns for s in good]
    assert np.all(np.diff(measured) > 0)
    sequence = [s.stamp.seq for s in watched.samples]
    assert np.all(np.diff(sequence) >= 0)
    for sample in good:
        assert watched.began_ns - 300_000_000 <= sample.stamp.t_ns <= sample.stamp.host_ns + 1_000_000
        assert watched.began_ns - 1_000_000 <= sample.stamp.host_ns <= watched.ended_ns


def test_arrays_have_their_shape_and_no_data_is_never_a_number(watched):
    for sample in watched.samples:
        for name, width in ARRAYS[watched.name].items():
            values = getattr(sample, name)
            assert values.shape == (width,)
            assert values.dtype == np.float64
            states = statuses(sample)
            for i in range(width):
                state = states[i] if len(states) == width else states[0]
                if state is Status.OK:
                    assert np.isfinite(values[i])
                elif state in (Status.TIMEOUT, Status.CRC, Status.PARITY, Status.PROTOCOL):
                    assert np.isnan(values[i])


def test_a_sample_is_delivered_once(watched):
    keys = [(s.stamp.t_ns, s.stamp.seq) for s in watched.samples]
    assert len(set(keys)) == len(keys)


def test_a_read_never_waits_for_the_next_sample(device, bench, collect):
    collect(device, 0.2)
    longest_ns = 0
    for _ in range(20):
        began_ns = bench.clock.now_ns()
        device.read()
        longest_ns = max(longest_ns, bench.clock.now_ns() - began_ns)
        bench.clock.sleep_until_ns(began_ns + 10_000_000)
    assert longest_ns < 60_000_000
