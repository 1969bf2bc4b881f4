"""Sends calibrated wheel odometry to a tracking camera in every cycle, if configured.

The odometry uses the wheels only. The filter's state contains the camera's poses, which would then count
twice in the camera.
"""

import math
from typing import Any

from hil.bench.pipelines import BenchModel
from hil.config.bench import BenchConfig
from hil.config.servos import ServosConfig
from hil.config.tracker import T265Config
from hil.core.interfaces import Estimator, Sink
from hil.core.signals import CycleRecord
from hil.loop.device_set import DeviceSet


class WheelFeed(Sink):
    """Sink that sends the wheel velocity of each cycle to the camera.

    Args:
        odometry: odometry of the calibrated wheels.
        tracker: driver with `take_wheel_velocity`, which never waits or raises.
    """

    def __init__(self, odometry: Estimator, tracker: Any) -> None:
        self._odometry, self._tracker = odometry, tracker

    def write(self, record: CycleRecord) -> None:
        """Send the velocity of the body's origin in body axes, if the wheels were read."""
        if not record.measurements.wheels:
            return
        v_x_m_s, v_y_m_s, _ = self._odometry.update(record.measurements).twist_body.tolist()
        if math.isfinite(v_x_m_s + v_y_m_s):
            self._tracker.take_wheel_velocity(v_x_m_s, v_y_m_s)

    def close(self) -> None:
        """Do nothing: the camera continues without wheel odometry."""


def wheel_feed(model: BenchModel, devices: DeviceSet) -> tuple[Sink, ...]:
    """The sink that sends wheel odometry to the camera, if `tracker.wheel_odometry` asks for it."""
    camera = model.config.of(T265Config)
    if camera is None or not camera.wheel_odometry:
        return ()
    return (WheelFeed(model.make_estimator("odometry", diagnostics=False), devices.get("tracker")),)


def with_wheel_sigma(config: BenchConfig) -> BenchConfig:
    """A configuration in which the camera has the standard deviation of the wheel velocity.

    Per axis, between two servo reads at the highest speed, from the noise that the estimator assumes
    (`estimator.wheels`) and from creep.
    """
    camera, servos = config.of(T265Config), config.of(ServosConfig)
    if camera is None or servos is None or not camera.wheel_odometry or camera.wheel_sigma_m_s is not None:
        return config
    noise, slip = config.estimator.wheels, getattr(config.estimator, config.environment.kind)
    speed_m_s, rate_hz = config.control.wheel_speed_m_s, config.loop.rate_hz
    step_m2 = 0.25 * (noise.step_m**2 + noise.per_sqrt_m**2 * speed_m_s / rate_hz)
    sigma_m_s = math.sqrt(step_m2 * rate_hz**2 + (slip.creep * speed_m_s) ** 2)
    reported = camera.model_copy(update={"wheel_sigma_m_s": min(max(sigma_m_s, 1e-4), 0.1)})
    return config.model_copy(update={"tracker": reported})
