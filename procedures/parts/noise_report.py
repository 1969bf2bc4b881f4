"""What `sensor_noise` finds, by name: measurements, table, figures of the record, values of `[estimator]`."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass

from hil.config.robot_record import Figure
from hil.estimator.sample_statistics import Spread
from hil.estimator.sensor_noise import SensorNoise
from hil.procedure import Context

_LEAST = 1e-9


@dataclass(frozen=True)
class Quantity:
    """One standard deviation that is measured.

    Attributes:
        name: of the measurement.
        device: whose noise it is; without it there is none.
        unit: for people; `per_si` of it are one in SI units.
        si: the unit in the record.
        meaning: in words.
        of: its variance in what was found.
    """

    name: str
    device: str
    unit: str
    per_si: float
    si: str
    meaning: str
    of: Callable[[SensorNoise], Spread]


def _both(
    name: str, device: str, unit: str, per_si: float, si: str, what: str, field: str
) -> Iterator[Quantity]:
    """A quantity at rest and in motion."""
    for state, words in (("rest", "at rest"), ("moving", "in motion")):
        yield Quantity(
            f"{name}_{state}",
            device,
            unit,
            per_si,
            si,
            f"{what}, {words}",
            lambda n, state=state: getattr(getattr(n, field), state),  # type: ignore[misc]
        )


FOUND: tuple[Quantity, ...] = (
    *_both("wheel_step", "servos", "um", 1e6, "m", "a wheel's way between two reads", "wheel_step"),
    Quantity(
        "wheel_walk", "servos", "um/√m", 1e6, "m/√m", "random slip of one wheel", lambda n: n.wheel_walk
    ),
    *_both("gyro", "imu", "mrad/s", 1e3, "rad/s", "one rate of the gyro", "gyro"),
    *_both("camera_position", "tracker", "mm", 1e3, "m", "one pose of the camera", "camera_position"),
    *_both("camera_heading", "tracker", "mrad", 1e3, "rad", "one heading of the camera", "camera_heading"),
    Quantity(
        "camera_walk", "tracker", "mm/√m", 1e3, "m/√m", "drift of the camera by way", lambda n: n.camera_walk
    ),
    Quantity("camera_creep", "tracker", "mm/√s", 1e3, "m/√s", "its drift at rest", lambda n: n.camera_creep),
    Quantity(
        "camera_turn", "tracker", "mrad/√s", 1e3, "rad/√s", "drift of its heading", lambda n: n.camera_turn
    ),
    *_both("mocap_position", "mocap", "mm", 1e3, "m", "one pose of motion capture", "mocap_position"),
    *_both("mocap_heading", "mocap", "mrad", 1e3, "rad", "one heading of motion capture", "mocap_heading"),
    Quantity(
        "push",
        "mocap",
        "mm/s²/√Hz",
        1e3,
        "m/s²/√Hz",
        "change of speed, at starts and stops",
        lambda n: n.push,
    ),
    Quantity(
        "twist", "mocap", "mrad/s²/√Hz", 1e3, "rad/s²/√Hz", "usual change of the rate", lambda n: n.twist
    ),
)
"""All that is measured."""

_KEYS: Mapping[str, tuple[str, Callable[[SensorNoise], Spread]]] = {
    "wheels.step_m": ("servos", lambda n: n.wheel_step.both),
    "wheels.per_sqrt_m": ("servos", lambda n: n.wheel_walk),
    "process.acceleration_m_s2_sqrt_hz": ("mocap", lambda n: n.push),
    "process.angular_acceleration_rad_s2_sqrt_hz": ("mocap", lambda n: n.twist),
    "gyro.rate_rad_s": ("imu", lambda n: n.gyro.both),
    "tracker.position_m": ("tracker", lambda n: n.camera_position.both),
    "tracker.heading_rad": ("tracker", lambda n: n.camera_heading.both),
    "tracker.drift_per_sqrt_m": ("tracker", lambda n: n.camera_walk),
    "tracker.drift_per_sqrt_s": ("tracker", lambda n: n.camera_creep),
    "tracker.yaw_drift_per_sqrt_s": ("tracker", lambda n: n.camera_turn),
    "mocap.position_m": ("mocap", lambda n: n.mocap_position.both),
    "mocap.heading_rad": ("mocap", lambda n: n.mocap_heading.both),
}
"""Keys of `[estimator]`, whose device they are of, and their variances."""


def values_of(found: SensorNoise, devices: Collection[str]) -> dict[str, float]:
    """Values of `[estimator]` by dotted name; none of a sensor of which nothing was seen."""
    values = {}
    for key, (device, of) in _KEYS.items():
        sigma = of(found).sigma()[0]
        if device in devices and math.isfinite(sigma):
            values[key] = max(sigma, _LEAST)
    return values


def _shown(found: SensorNoise, devices: Collection[str]) -> Iterator[tuple[Quantity, float, float, float]]:
    for one in FOUND:
        if one.device in devices:
            yield (one, *one.of(found).sigma())


def leave_measurements(
    ctx: Context, found: SensorNoise, nis: Mapping[str, float], devices: Collection[str]
) -> None:
    """Set what is declared: each figure with half of its interval, and the mean NIS with it."""
    for one, sigma, low, high in _shown(found, devices):
        ctx.measure(one.name, one.per_si * sigma)
        ctx.measure(f"{one.name}_uncertainty", one.per_si * 0.5 * (high - low))
    for sensor, device in (("wheels", "servos"), ("gyro", "imu"), ("tracker", "tracker")):
        if device in devices:
            ctx.measure(f"nis.{sensor}", nis.get(sensor, math.nan))


def figures(found: SensorNoise, devices: Collection[str]) -> dict[str, Figure]:
    """Figures of the record in SI units, with their standard uncertainties."""
    return {
        one.name: Figure(value=sigma, sigma=0.25 * (high - low), unit=one.si)
        for one, sigma, low, high in _shown(found, devices)
        if math.isfinite(sigma)
    }


def table(ctx: Context, found: SensorNoise, devices: Collection[str]) -> None:
    """What was found, with 95 % intervals."""
    rows = [
        [
            one.meaning,
            f"{one.per_si * sigma:.3g}",
            f"{one.per_si * low:.3g} .. {one.per_si * high:.3g}",
            one.unit,
        ]
        for one, sigma, low, high in _shown(found, devices)
    ]
    ctx.table(
        "Noise of the sensors",
        ["standard deviation of", "found", "95 %", "unit"],
        rows,
        "White noise is per sample; a drift grows with the root of way or time.",
    )
