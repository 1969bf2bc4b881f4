"""Arithmetic of the emulated chips: machine code and plain Python give the same bits."""

import numpy as np
import pytest

from hil.config.servo_models import DEFAULT_MODEL, servo_model
from hil.fakes.encoders import as5045
from hil.fakes.imu import output, registers
from hil.fakes.imu.sample import counts
from hil.fakes.imu.sensors import ImuTruthOptions, InertialSensors, Sensed, matrix
from hil.fakes.mocap.capture import CaptureVolume
from hil.fakes.mocap.options import MocapTruthOptions
from hil.fakes.plant_api import BodyMotion
from hil.fakes.servos.sensing import Sensing
from hil.fakes.tracker.odometry import VisualOdometry
from hil.fakes.tracker.options import TrackerTruthOptions
from hil.vocabulary import arithmetic

pytest.importorskip("numba", reason="machine code needs the extra `fast`")
UNITS = (0x00, 0x80, registers.UNIT_MG | registers.UNIT_RAD_S | registers.UNIT_EULER_RAD)


@pytest.fixture(params=(1, 2, 3))
def draws(request):
    return np.random.default_rng(request.param)


@pytest.fixture
def twice(monkeypatch):
    """What makes the same thing twice: compiled, and as it is where numba is missing."""

    def make(what):
        compiled = what()
        with monkeypatch.context() as without:
            without.setattr(arithmetic, "is_installed", lambda extra: False)
            return compiled, what()

    return make


def attitude(draws):
    q = draws.standard_normal(4)
    return tuple((q / np.linalg.norm(q)).tolist())


def motion(draws, k):
    """Now at rest, now anywhere."""
    values = np.zeros(8) if k % 40 < 10 else draws.normal(size=8)
    return BodyMotion(*values.tolist(), 1.2)


def bits(values):
    return np.concatenate([np.ravel(v) for v in values]).tobytes()


def test_the_camera_sees_the_same_with_and_without_machine_code(twice, draws, monkeypatch):
    mount = {"mount_position_m": tuple(draws.normal(size=3)), "mount_rotation_wxyz": attitude(draws)}
    seed = int(draws.integers(1000))
    made = twice(lambda: VisualOdometry(TrackerTruthOptions(), np.random.default_rng(seed), **mount))
    assert type(made[0]._state) is np.ndarray
    assert type(made[1]._state) is list
    for k in range(1200):  # more than two blocks of noise
        body, dt_s = motion(draws, k), float(draws.uniform(0.001, 0.02))
        wheels = (draws.normal(size=3), 0.4) if k % 3 == 0 else None
        seen = []
        for compiled, odometry in zip((True, False), made, strict=True):
            with monkeypatch.context() as patch:
                if not compiled:
                    patch.setattr(arithmetic, "is_installed", lambda extra: False)
                if k % 500 == 300:
                    odometry.jump(0.1)
                    odometry.drift(0.01, -0.02)
                if k % 500 == 400:
                    odometry.restart()
                seen.append(bits(odometry.observe(body, dt_s, 1.0 + 0.01 * (k % 5), wheels)))
        assert seen[0] == seen[1], k


def test_the_chip_shows_the_same_with_and_without_machine_code(twice, draws, monkeypatch):
    mount, seed = matrix(attitude(draws)), int(draws.integers(1000))
    made = twice(lambda: InertialSensors(ImuTruthOptions(), np.random.default_rng(seed), chip_in_body=mount))
    counting = twice(lambda: output._counting.__wrapped__())
    assert counting[1] is counts
    for k in range(2200):  # more than two blocks of noise
        body, mode = motion(draws, k), registers.MODES[k // 50 % 13]
        shown = []
        for compiled, sensors, count in zip((True, False), made, counting, strict=True):
            with monkeypatch.context() as patch:
                if not compiled:
                    patch.setattr(arithmetic, "is_installed", lambda extra: False)
                patch.setattr(output, "_counting", lambda found=count: found)
                if k % 600 == 500:
                    sensors.set_remap(0x21, 0x04)
                if k % 600 == 550:
                    sensors.restart_fusion()
                    sensors.turn(0.3)
                sensed = sensors.sense(body, mode, 1.0 / mode.rate_hz)
                blocks = b"".join(output.encode(sensed, mode, units, 0, 20.0) for units in UNITS)
                shown.append(bits(sensed) + blocks)
        assert shown[0] == shown[1], k


@pytest.mark.parametrize("up_axis", ["y", "z"])
def test_motion_capture_sees_the_same_with_and_without_machine_code(twice, draws, up_axis):
    seed, options = int(draws.integers(1000)), MocapTruthOptions(occlusions_per_s=1.0)
    kwargs = {"body": "robot", "body_id": 1, "up_axis": up_axis}
    made = twice(lambda: CaptureVolume(options, np.random.default_rng(seed), **kwargs))
    assert [type(volume._draws) for volume in made] == [np.ndarray, list]
    for k in range(1200):  # more than two blocks of noise
        body, seen = motion(draws, k), []
        for compiled, volume in zip((True, False), made, strict=True):
            with pytest.MonkeyPatch.context() as patch:
                if not compiled:
                    patch.setattr(arithmetic, "is_installed", lambda extra: False)
                seen.append(volume.see(body, k * 10_000_000))
        assert seen[0] == seen[1], k


class Joints:
    """Joints that turn, and rest at times, as told."""

    def __init__(self):
        self.now = np.zeros((3, 8))

    def joints(self):
        return tuple(self.now)


def test_the_servos_measure_the_same_with_and_without_machine_code(twice, draws):
    joints, seed = Joints(), int(draws.integers(1000))
    made = twice(lambda: Sensing(joints, np.random.default_rng(seed), (servo_model(DEFAULT_MODEL),) * 8))
    assert [type(sensing._history) for sensing in made] == [np.ndarray, list]
    for k in range(400):  # more than two blocks of dither
        if k % 90 > 20:
            joints.now = joints.now + draws.normal(size=(3, 8)) * [[0.02], [0.1], [0.1]]
        for sensing in made:
            sensing.tick()
        if k % 5 < 3:
            assert made[0].measure().tolist() == made[1].measure(), k
        for age_ns in (0, 8_000_000, 10**9):
            assert made[0].counts(age_ns) == made[1].counts(age_ns), k
            assert made[0].velocity(age_ns) == made[1].velocity(age_ns), k


@pytest.mark.parametrize("flags", [0, as5045.MAG_INC, as5045.COF])
def test_the_encoders_say_the_same_with_and_without_machine_code(twice, draws, flags):
    chips, block = [], draws.standard_normal((400, 5))
    for _ in range(4):
        once, errors = draws.normal(0.0, 0.1, (2, 2)).tolist()
        chips += as5045.chip(once=once, twice=errors, noise_rad=0.01, sign=-1, zero_rad=draws.normal())
    chips[as5045.CHIP_SIZE + as5045.FLAGS] = flags

    def make():
        numbers, noise = arithmetic.vector(chips), arithmetic.rows(block)
        said = arithmetic.quick(as5045.words, numbers, 0.0, 0.0, 0.0, 0.0, noise, 0, 0)
        return lambda angles, row, more: said(numbers, *angles, noise, row, more)

    compiled, plain = twice(make)
    for row in range(400):
        angles, more = draws.normal(0.0, 5.0, 4).tolist(), as5045.OCF if row > 3 else 0
        words = plain(angles, row, more)
        assert compiled(angles, row, more) == words
        assert words == tuple(as5045.with_parity(word) for word in words)


def test_the_servos_measure_what_their_firmware_does():
    """Counts to the nearest with dither, velocity over 76 ms that ended 12 ms ago, truncated towards zero."""
    joints, model = Joints(), servo_model(DEFAULT_MODEL)
    sensing = Sensing(joints, np.random.default_rng(1), (model,) * 8)
    dither = np.random.default_rng(1).normal(0.0, 0.25, (128, 8))
    rate_rad_s = np.linspace(-3.0, 3.0, 8)
    seen = [np.zeros(8)]
    for k in range(1, 100):
        joints.now[0] = rate_rad_s * 0.004 * k
        joints.now[2] = rate_rad_s
        seen.append(np.rint(joints.now[0] / model.rad_per_count + dither[k]))
        sensing.tick()
    counts, velocities, currents = arithmetic.listed(sensing.measure())
    assert counts == seen[-1].tolist()
    turned = (seen[-4] - seen[-23]) * model.rad_per_count / 0.076
    assert velocities == np.trunc(turned / model.rad_s_per_count).tolist()
    assert currents == np.trunc(rate_rad_s / model.a_per_count).tolist()
    assert sensing.counts(40_000_000) == seen[-11].tolist()


@pytest.mark.parametrize(
    ("value", "count"),
    [(0.5, 0), (1.5, 2), (-2.5, -2), (32767.4, 32767), (1e300, 32767), (-32768.6, -32768), (-1e300, -32768)],
)
def test_a_count_is_the_nearest_that_a_register_holds(twice, value, count):
    three = (0.0, 0.0, 0.0)
    sensed = Sensed((value, 0.0, 0.0), three, three, (1.0, 0.0, 0.0, 0.0), three, three)
    for counting in twice(lambda: output._counting.__wrapped__()):
        assert counting(sensed, 1.0, 1.0, 1.0, 1.0, False)[0] == count
