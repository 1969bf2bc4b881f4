"""The figures of the sensors' noise by name: whose they are, their units, and their keys of `[estimator]`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from hil.estimator.sample_statistics import Spread
from hil.estimator.sensor_noise import SensorNoise, Spreads


@dataclass(frozen=True)
class NoiseFigure:
    """One standard deviation.

    Attributes:
        name: of the field of `SensorNoise` that holds its variance.
        device: whose noise it is; without it there is none.
        unit: for people; `per_si` of it are one in SI units.
        si: the unit in the record.
        meaning: in words.
        key: of `[estimator]` that it is the value of.
        state: `rest` or `moving`: in that state alone; empty for all that was found.
    """

    name: str
    device: str
    unit: str
    per_si: float
    si: str
    meaning: str
    key: str
    state: str = ""

    @property
    def label(self) -> str:
        """Of the measurement and of the figure in the record."""
        return f"{self.name}_{self.state}" if self.state else self.name

    def of(self, found: SensorNoise) -> Spread:
        """Its variance in what was found."""
        spread = getattr(found, self.name)
        if not isinstance(spread, Spreads):
            return spread  # type: ignore[no-any-return]
        return getattr(spread, self.state or "both")  # type: ignore[no-any-return]


def _by_state(one: NoiseFigure) -> Iterator[NoiseFigure]:
    for state, words in (("rest", "at rest"), ("moving", "in motion")):
        yield replace(one, state=state, meaning=f"{one.meaning}, {words}")


NOISE_FIGURES: tuple[NoiseFigure, ...] = (
    NoiseFigure("wheel_step", "servos", "um", 1e6, "m", "a wheel's way between two reads", "wheels.step_m"),
    NoiseFigure(
        "wheel_walk", "servos", "um/√m", 1e6, "m/√m", "random slip of one wheel", "wheels.per_sqrt_m"
    ),
    NoiseFigure("gyro", "imu", "mrad/s", 1e3, "rad/s", "one rate of the gyro", "gyro.rate_rad_s"),
    NoiseFigure("camera_position", "tracker", "mm", 1e3, "m", "one pose of the camera", "tracker.position_m"),
    NoiseFigure(
        "camera_heading", "tracker", "mrad", 1e3, "rad", "one heading of the camera", "tracker.heading_rad"
    ),
    NoiseFigure(
        "camera_walk",
        "tracker",
        "mm/√m",
        1e3,
        "m/√m",
        "drift of the camera by way",
        "tracker.drift_per_sqrt_m",
    ),
    NoiseFigure(
        "camera_creep", "tracker", "mm/√s", 1e3, "m/√s", "its drift at rest", "tracker.drift_per_sqrt_s"
    ),
    NoiseFigure(
        "camera_turn",
        "tracker",
        "mrad/√s",
        1e3,
        "rad/√s",
        "drift of its heading",
        "tracker.yaw_drift_per_sqrt_s",
    ),
    NoiseFigure("mocap_position", "mocap", "mm", 1e3, "m", "one pose of motion capture", "mocap.position_m"),
    NoiseFigure(
        "mocap_heading", "mocap", "mrad", 1e3, "rad", "one heading of motion capture", "mocap.heading_rad"
    ),
    NoiseFigure(
        "push",
        "mocap",
        "mm/s²/√Hz",
        1e3,
        "m/s²/√Hz",
        "change of speed, at starts and stops",
        "process.acceleration_m_s2_sqrt_hz",
    ),
    NoiseFigure(
        "twist",
        "mocap",
        "mrad/s²/√Hz",
        1e3,
        "rad/s²/√Hz",
        "usual change of the rate",
        "process.angular_acceleration_rad_s2_sqrt_hz",
    ),
)
"""One for each value of `[estimator]`."""

MEASURED: tuple[NoiseFigure, ...] = tuple(
    part
    for one in NOISE_FIGURES
    for part in (_by_state(one) if isinstance(getattr(SensorNoise(), one.name), Spreads) else (one,))
)
"""All that is measured, at rest and in motion where that differs."""
