"""Compares external steering encoders with the servos' angles at rest, by the offsets in the record.

The two angles are measured independently, so their difference does not depend on the steering angle. It
changes when a horn or an encoder has slipped, even while no program ran.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hil.config.bench import BenchConfig
from hil.config.encoders import EncodersConfig
from hil.config.servos import ServosConfig
from hil.core.finding import Finding
from hil.core.geometry import mean_angle, wrap
from hil.core.signals import WHEELS, EncoderSample, ServoSample, Status


def encoder_minus_servo(
    config: BenchConfig, encoders: Sequence[EncoderSample], servos: Sequence[ServoSample]
) -> tuple[float, ...]:
    """Encoder minus servo angle (4,) per steering axis, with signs, without zeros, rad; NaN if unknown.

    Args:
        config: the bench configuration, for the signs.
        encoders: samples of a robot at rest.
        servos: samples of the same rest.
    """
    table = config.of(EncodersConfig)
    if table is None:
        return (math.nan,) * 4
    differences = []
    for k, (sign, steer_sign) in enumerate(zip(table.sign, config.alignment.steer_sign, strict=True)):
        outside = mean_angle([float(s.angle_rad[k]) for s in encoders if s.status[k] is Status.OK])
        inside = mean_angle([float(s.position_rad[4 + k]) for s in servos if s.status[4 + k] is Status.OK])
        differences.append(wrap(sign * outside - steer_sign * inside))
    return tuple(differences)


def expected_offsets_rad(config: BenchConfig) -> tuple[float, ...] | None:
    """Expected encoder minus steering angle (4,), with zeros, as the loop compares them, rad.

    None if the record has no offsets.
    """
    table, own = config.of(EncodersConfig), config.alignment
    if table is None or table.minus_servo_rad is None:
        return None
    known = zip(
        table.minus_servo_rad, table.sign, table.zeros_rad, own.steer_sign, own.steer_zero_rad, strict=True
    )
    return tuple(wrap(off - sign * zero + steer * steer_zero) for off, sign, zero, steer, steer_zero in known)


def slipped_between(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[Finding]:
    """Findings on slipped steering axes; none without recorded offsets, or without samples.

    Args:
        config: the bench configuration.
        seen: samples of every kind that was watched, at rest.
    """
    table, servos = config.of(EncodersConfig), config.of(ServosConfig)
    if table is None or servos is None or table.minus_servo_rad is None or "encoders" in config.elsewhere():
        return
    now = encoder_minus_servo(config, seen.get("encoders", ()), seen.get("servos", ()))
    for wheel, ident, kept_rad, now_rad in zip(
        WHEELS, servos.steer_ids, table.minus_servo_rad, now, strict=True
    ):
        moved_rad = wrap(now_rad - kept_rad)
        if math.isnan(moved_rad):
            continue
        apart = abs(moved_rad) > table.horn_slip_threshold_rad
        yield Finding(
            "encoders",
            f"{wheel} against its servo",
            "failure" if apart else "ok",
            f"{moved_rad:+.3f} rad since it was measured",
            f"within {table.horn_slip_threshold_rad:g} rad",
            f"the horn or an encoder of steer_{wheel} (ID {ident}) has slipped: tighten it, then "
            "`hil run bring_up`, `hil run steering_zero` and `hil run odometry_calibration`",
        )
