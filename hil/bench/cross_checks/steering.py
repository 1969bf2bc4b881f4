"""Steering servos against external encoders at rest: their zeros have to fit together."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hil.bench.doctor.steering_offsets import encoder_minus_servo
from hil.config.bench import BenchConfig
from hil.config.encoders import EncodersConfig
from hil.config.servos import ServosConfig
from hil.core.cross_check import CrossCheck, State
from hil.core.geometry import wrap
from hil.core.signals import WHEELS

MOST_RAD = 0.03
"""Difference that right zeros may have, and up to which they are confirmed: 1.4 deg of an AS5045 over a
magnet off its centre, a quarter of a degree of backlash."""
_ALIKE_RAD, _HORN_RAD = 0.04, 0.08
"""Differences that zeros of a robot as delivered may have, all wheels alike and one: horns are screwed on
within 2.5 deg, each its own way."""


def steering_checks(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[CrossCheck]:
    """Compare the encoders, with their zeros, with the servos.

    Nothing where a zero is not known, or where both were measured together: then only a slip changes them.

    Args:
        config: configuration of the bench.
        seen: samples of the resting robot, by kind.
    """
    table, own = config.of(EncodersConfig), config.alignment
    if table is None or config.of(ServosConfig) is None or "encoders" in config.elsewhere():
        return
    if table.zero_rad is None or table.minus_servo_rad is not None:
        return
    if not (seen.get("encoders") and seen.get("servos")):
        return
    now = encoder_minus_servo(config, seen["encoders"], seen["servos"])
    zeros = zip(now, table.sign, table.zero_rad, own.steer_sign, own.steer_zero_rad, strict=True)
    off = [wrap(both - sign * zero + steer * horn) for both, sign, zero, steer, horn in zeros]
    known = [value for value in off if math.isfinite(value)]
    if not known:
        return
    worst_rad, alike_rad = max(known, key=abs), abs(sum(known)) / len(known)
    keys = (("encoders.zero_rad", table.zero_rad), ("alignment.steer_zero_rad", own.steer_zero_rad))
    if abs(worst_rad) <= _HORN_RAD and alike_rad <= _ALIKE_RAD:
        state: State = "confirmed" if abs(worst_rad) <= MOST_RAD else "unconfirmed"
        for (key, value), by, (other, _) in zip(
            keys, ("the servos", "the encoders"), keys[::-1], strict=True
        ):
            said = by if state == "confirmed" else f"{by}, which show {worst_rad:+.3f} rad"
            yield CrossCheck(
                key, value, state, said, value, worst_rad, within=MOST_RAD, unit="rad", given=(other,)
            )
        return
    said = ", ".join(
        f"{wheel} {value:+.3f} rad" for wheel, value in zip(WHEELS, off, strict=True) if abs(value) > MOST_RAD
    )
    fits = (
        [z + s * o for z, s, o in zip(table.zero_rad, table.sign, off, strict=True)],
        [h - s * o for h, s, o in zip(own.steer_zero_rad, own.steer_sign, off, strict=True)],
    )
    text = (
        f"the encoders and the steering servos differ by {said}: either encoders.zero_rad or "
        "alignment.steer_zero_rad is wrong, or a horn or an encoder has slipped; `hil run steering_zero`"
    )
    for (key, value), says, by in zip(keys, fits, ("the servos", "the encoders"), strict=True):
        yield CrossCheck(
            key, value, "contradicted", by, [round(v, 4) for v in says], worst_rad, text, unit="rad"
        )
