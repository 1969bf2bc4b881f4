"""What the camera is given: how to treat its map, and the velocity of the wheels; what it makes of that.

librealsense's software device takes the settings of the map. It has no wheel odometer: for that stands the
emulated camera, in process and behind its feed.
"""

import dataclasses
import json
import math
import threading

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

import hil
from hil.bench.camera_odometry import with_wheel_sigma
from hil.config.loading import load_bench
from hil.config.tracker import T265Config
from hil.core.clock import MonotonicClock
from hil.core.errors import ConfigError, DeviceError
from hil.core.geometry import quat_from_rotvec
from hil.drivers.tracker.t265.driver import T265Tracker
from hil.drivers.tracker.t265.settings import wheel_calibration
from hil.fakes.tracker.t265.chip import T265
from hil.fakes.tracker.t265.pose_server import TrackerTransport
from hil.fakes.tracker.t265.wheel_odometer_input import WheelInput
from hil.fakes.tracker.true_parameters import IDEAL, TrackerTruthOptions
from hil.fakes.world import World
from tests.tracker.software_device import SoftwareT265
from tests.tracker.test_tracker_across_processes import feed_config, serving

KEYS = ("mapping", "relocalisation", "pose_jumping", "map_preservation")
MAP = ("enable_mapping", "enable_relocalization", "enable_pose_jumping", "enable_map_preservation")
TILTED = tuple(float(v) for v in quat_from_rotvec([0.05, -0.3, 0.2]))
SCALED = dataclasses.replace(IDEAL, scale_sigma=0.03)


@pytest.mark.parametrize(
    ("keys", "reported"),
    [({}, (0, 0, 0, 0)), ({"mapping": True}, (1, 0, 0, 0)), (dict.fromkeys(KEYS, True), (1, 1, 1, 1))],
)
def test_the_camera_gets_the_options_of_its_map(tracker_bench, keys, reported):
    bench = tracker_bench(config=keys)
    assert tuple(bench.camera.settings[name] for name in MAP) == (1, 1, 1, 1)  # as it is plugged in
    bench.driver.open()
    assert tuple(bench.camera.settings[name] for name in MAP) == reported


@pytest.mark.parametrize(
    "keys", [{"relocalisation": True}, {"map_preservation": True}, {"wheel_sigma_m_s": 0.01}]
)
def test_what_needs_a_map_or_wheel_odometry_is_refused_without_it(keys):
    with pytest.raises(ValidationError, match=r"mapping|wheel_odometry"):
        T265Config(**keys)


def test_wheel_odometry_needs_wheels(tmp_path):
    file = tmp_path / "bench.toml"
    file.write_text('schema = 1\nname = "b"\n[tracker]\nbackend = "emulated"\nwheel_odometry = true\n')
    with pytest.raises(ConfigError) as reported:
        load_bench(file)
    assert "tracker.wheel_odometry" in str(reported.value.problems)
    assert "no [servos]" in str(reported.value.problems)


def test_poses_jump_only_where_they_may(tracker_bench, follow):
    options = TrackerTruthOptions(relocalisations_per_s=2.0)
    jumps = []
    for allowed in (True, False):
        bench = tracker_bench(options=options, config={"mapping": allowed, "pose_jumping": allowed})
        bench.driver.open()
        jumps.append(sum(s.status.value == "jump" for s in follow(bench, 3.0)))
    assert jumps[0] > 0
    assert jumps[1] == 0


class NoSettings:
    """A camera of another firmware, with settings or without."""

    def __init__(self, known):
        self.known = known

    def get_device(self):
        return self

    def query_sensors(self):
        return [self]

    def supports(self, option):
        return self.known

    def set_option(self, option, value):
        """Taken, and forgotten."""

    def get_option(self, option):
        return 0.0

    def as_wheel_odometer(self):
        raise RuntimeError('null pointer passed for argument "sensor"')


@pytest.mark.parametrize(
    ("known", "keys", "what"),
    [
        (False, {}, "no settings for its map"),
        (True, {"mapping": True}, "does not take enable_mapping = 1"),
        (True, {"wheel_odometry": True}, "takes no wheel odometry"),
    ],
)
def test_a_camera_with_other_firmware_is_named(tracker_bench, known, keys, what):
    bench = tracker_bench(config=keys)
    pipeline = bench.camera.pipeline()
    pipeline.resolve = lambda: NoSettings(known)
    driver = T265Tracker(bench.config, bench.clock, pipeline=pipeline)
    with pytest.raises(DeviceError, match=what) as reported:
        driver.open()
    assert "firmware" in reported.value.expected


@pytest.mark.parametrize("mount", [(1.0, 0.0, 0.0, 0.0), TILTED])
def test_the_calibration_leads_from_the_body_to_the_cameras_axes(mount):
    """X right, Y up, Z back: a body that drives ahead moves to -Z of a camera that looks ahead."""
    config = T265Config(mount_rotation_wxyz=mount, wheel_odometry=True, wheel_sigma_m_s=0.02)
    (sensor,) = json.loads(wheel_calibration(config))["velocimeters"]
    turn = Rotation.from_rotvec(sensor["extrinsics"]["W"]).as_matrix()
    w, x, y, z = mount
    in_robot_axes = Rotation.from_quat([x, y, z, w]).as_matrix().T
    for axis in np.eye(3):
        forward, left, up = in_robot_axes @ axis
        np.testing.assert_allclose(turn @ axis, [-left, up, -forward], atol=1e-12)
    np.testing.assert_allclose(
        sensor["extrinsics"]["T"], turn @ -np.array(config.mount_position_m), atol=1e-12
    )
    assert sensor["noise_variance"] == pytest.approx(4e-4)
    np.testing.assert_array_equal(sensor["scale_and_alignment"], np.eye(3).ravel())


def driven(bench, follow, v_x, v_y, seconds=4.0):
    """Poses while the camera is given a velocity every 10 ms."""
    samples = []
    for _ in range(round(seconds / 0.01)):
        bench.driver.take_wheel_velocity(v_x, v_y)
        samples += follow(bench, 0.01)
    return samples


def test_correct_wheel_odometry_lessens_the_cameras_error_of_scale(tracker_bench, travelling_plant, follow):
    """Told in other axes, or wrongly, they would make it worse: frames are looked at, too."""
    twist = (0.08, -0.05, 0.3)
    off_m = {}
    for wheels, reported in (("none", None), ("right", twist[:2]), ("wrong", (-0.08, 0.05))):
        config = {"mount_rotation_wxyz": TILTED, "wheel_odometry": reported is not None}
        plant = travelling_plant(twist=twist, tilt_rad=0.7)
        bench = tracker_bench(plant=plant, options=SCALED, config=config, seed=3)
        bench.driver.open()
        samples = follow(bench, 4.0) if reported is None else driven(bench, follow, *reported)
        gone_m = float(np.linalg.norm(samples[-1].position_m - samples[0].position_m))
        arm = np.array([*bench.config.mount_position_m[:2]])
        ends = []
        for sample in (samples[0], samples[-1]):
            x, y, theta = plant.pose(sample.stamp.t_ns)
            turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
            ends.append(np.array([x, y]) + turn @ arm)
        off_m[wheels] = abs(gone_m - float(np.linalg.norm(ends[1] - ends[0])))
    assert off_m["right"] < 0.5 * off_m["none"]
    assert off_m["wrong"] > 2.0 * off_m["none"]


@pytest.mark.parametrize(
    ("sensor", "number", "velocity"),
    [(1, 2, (0.1, 0, 0)), (0, 1, (0.1, 0, 0)), (0, 2, (math.nan, 0, 0))],
    ids=["another sensor", "an old number", "no number"],
)
def test_a_velocity_that_cannot_be_one_is_not_taken(sensor, number, velocity):
    wheels = WheelInput()
    assert not wheels.send(0, 1, (0.1, 0, 0), 0)  # nothing is known of its sensor yet
    assert wheels.load(wheel_calibration(T265Config()).encode())
    assert wheels.send(0, 1, (0.1, 0, 0), 0)
    assert not wheels.send(sensor, number, velocity, 1)
    assert (wheels.taken, wheels.refused) == (1, 2)


@pytest.mark.parametrize("text", [b"", b'{"velocimeters": [{}]}', b"\xff"])
def test_what_is_no_calibration_is_not_taken(text):
    assert not WheelInput().load(text)


def test_a_whole_bench_reports_its_camera_of_its_wheels():
    with hil.open_bench("emulated", overrides={"tracker.wheel_odometry": True}) as bench:
        tracker = bench.devices.sensors["tracker"]
        bench.settle(0.5)
        camera = tracker._given._camera
        assert camera.wheels.taken > 20
        assert camera.wheels.refused == 0
        _, _, velocity = camera.wheels._last[0]
        assert np.linalg.norm(velocity) < 0.01  # it stands
        assert 1e-3 < tracker._config.wheel_sigma_m_s < 0.02


def test_how_well_the_wheels_know_follows_from_the_estimators_noise():
    reported = {}
    for name, more in {"as it comes": {}, "worse": {"estimator.wheels.per_sqrt_m": 0.02}}.items():
        config = load_bench("emulated", overrides={"tracker.wheel_odometry": True, **more})
        reported[name] = with_wheel_sigma(config).tracker.wheel_sigma_m_s
    assert reported["worse"] > 2.0 * reported["as it comes"]
    given = {"tracker.wheel_odometry": True, "tracker.wheel_sigma_m_s": 0.03}
    assert with_wheel_sigma(load_bench("emulated", overrides=given)).tracker.wheel_sigma_m_s == 0.03


def test_settings_and_velocities_cross_the_feed(travelling_plant):
    world = World(travelling_plant(), seed=1)
    camera = T265(world)
    transport = TrackerTransport(camera)
    config = feed_config(transport, wheel_odometry=True, mapping=True)
    driver = T265Tracker(config, MonotonicClock())
    with serving(world, {"tracker": transport}):
        driver.open()
        for _ in range(50):
            driver.take_wheel_velocity(0.1, 0.0)
            MonotonicClock().sleep_until_ns(MonotonicClock().now_ns() + 10_000_000)
            if camera.wheels.taken > 5:
                break
        assert camera.wheels.taken > 5
        assert tuple(camera.settings[name] for name in MAP) == (1, 0, 0, 0)
        assert transport.strange == 0
        driver.close()
    assert not [t for t in threading.enumerate() if t.name.startswith("tracker")]


def test_librealsenses_own_software_device_takes_the_settings(travelling_plant):
    library = pytest.importorskip("pyrealsense2", exc_type=ImportError)  # also where there is no libusb
    world = World(travelling_plant(), seed=1)
    software = SoftwareT265(T265(world), library)
    driver = T265Tracker(
        T265Config(mapping=True), MonotonicClock(), pipeline=software.pipeline(), library=library
    )
    with serving(world, {}):
        driver.open()
        assert tuple(software.option(name) for name in MAP) == (1, 0, 0, 0)
        driver.close()
        asking = T265Tracker(
            T265Config(wheel_odometry=True), MonotonicClock(), pipeline=software.pipeline(), library=library
        )
        with pytest.raises(DeviceError, match="takes no wheel odometry"):
            asking.open()
        software.close()
