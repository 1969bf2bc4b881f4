"""Table of the sensors' noise figures: name, device, units, and the key in `[estimator]`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from hil.estimator.sample_statistics import Spread
from hil.estimator.sensor_noise import SensorNoise, Spreads


@dataclass(frozen=True)
class NoiseFigure:
    """One standard deviation of the noise record.

    Attributes:
        name: field of `SensorNoise` that holds the variance.
        device: device that the noise belongs to; without this device the figure is absent.
        unit: display unit; `per_si` of it make one SI unit.
        si: unit in the record.
        meaning: description in words.
        key: key of `[estimator]` that takes the value.
        state: `rest` or `moving` for that state alone; empty for both together.
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
        """Name of the measurement and of the figure in the record."""
        return f"{self.name}_{self.state}" if self.state else self.name

    def of(self, found: SensorNoise) -> Spread:
        """Variance of this figure in the noise that was found."""
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
"""One figure for each measured key of `[estimator]`."""

MEASURED: tuple[NoiseFigure, ...] = tuple(
    part
    for one in NOISE_FIGURES
    for part in (_by_state(one) if isinstance(getattr(SensorNoise(), one.name), Spreads) else (one,))
)
"""All measured figures; those that depend on it once at rest and once in motion."""
