"""Results of `sensor_noise` as measurements, table, figures of the record, values of `[estimator]`."""

import math
from collections.abc import Collection, Iterator, Mapping

from hil.config.robot_record import Figure
from hil.estimator.noise_parameters import MEASURED, NOISE_FIGURES, NoiseFigure
from hil.estimator.sensor_noise import SensorNoise
from hil.procedure import Context

_LEAST = 1e-9


def values_of(found: SensorNoise, devices: Collection[str]) -> dict[str, float]:
    """Return values of `[estimator]` by dotted name, without those of sensors that have no samples."""
    values = {}
    for one in NOISE_FIGURES:
        sigma = one.of(found).sigma()[0]
        if one.device in devices and math.isfinite(sigma):
            values[one.key] = max(sigma, _LEAST)
    return values


def _shown(found: SensorNoise, devices: Collection[str]) -> Iterator[tuple[NoiseFigure, float, float, float]]:
    for one in MEASURED:
        if one.device in devices:
            yield (one, *one.of(found).sigma())


def leave_measurements(
    ctx: Context, found: SensorNoise, nis: Mapping[str, float], devices: Collection[str]
) -> None:
    """Set the declared measurements: each figure with half of its interval, and the mean NIS."""
    for one, sigma, low, high in _shown(found, devices):
        ctx.measure(one.label, one.per_si * sigma)
        ctx.measure(f"{one.label}_uncertainty", one.per_si * 0.5 * (high - low))
    for sensor, device in (("wheels", "servos"), ("gyro", "imu"), ("tracker", "tracker")):
        if device in devices:
            ctx.measure(f"nis.{sensor}", nis.get(sensor, math.nan))


def figures(found: SensorNoise, devices: Collection[str]) -> dict[str, Figure]:
    """Return figures of the record in SI units, with their standard uncertainties."""
    return {
        one.label: Figure(value=sigma, sigma=0.25 * (high - low), unit=one.si)
        for one, sigma, low, high in _shown(found, devices)
        if math.isfinite(sigma)
    }


def table(ctx: Context, found: SensorNoise, devices: Collection[str]) -> None:
    """Add a table of the results with 95 % intervals."""
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
