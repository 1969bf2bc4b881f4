"""Joints of an emulated robot: motors, gears and the servos' control loops, without wheel contacts.

They work on named records; `hil.fakes.plant.step_kernel` steps them with body and wheels.
"""

import math

from hil.fakes.plant.named_numbers import (
    MODE_CURRENT,
    MODE_OFF,
    MODE_POSITION,
    MODE_VELOCITY,
    Commands,
    Constants,
    State,
)
from hil.support.numba_jit import inner


@inner
def clip(value: float, limit: float) -> float:
    """Limit a value to +-limit."""
    return min(max(value, -limit), limit)


@inner
def motor(
    j: int, dt: float, pull: float, drag: float, friction: float, c: Constants, s: State, q: Commands
) -> tuple[float, float, float, float]:
    """Rate of joint `j` after an implicit step `dt` with an external torque `pull - drag * rate`.

    Returns:
        (rate, branch, free, compliance): rate = free + compliance * pull while the branch holds; a
        branch encodes the direction (0: stuck, compliance 0) and the active limit.
    """
    kt, ke, ohm = c.kt[j], c.ke[j], c.ohm[j]
    mode, limit_a, limit_v = q.mode[j], q.amps_limit[j], c.supply * q.duty_limit[j]
    base = c.joint_inertia[j] / dt * s.rate[j] + pull
    slope = c.joint_inertia[j] / dt + c.viscous[j] + drag
    push, gain, kind = 0.0, 0.0, 0.0
    if mode == MODE_CURRENT:
        push = kt * clip(q.goal[j], limit_a)
        volts = push / kt * ohm + ke * threshold(base + push, friction) / slope
        if abs(volts) > limit_v:
            push, gain, kind = kt / ohm * clip(volts, limit_v), kt / ohm * ke, math.copysign(2.0, volts)
    elif mode != MODE_OFF:
        level, fall = demand(j, dt, c, s, q)
        push, gain = kt / ohm * level, kt / ohm * (fall + ke)
        rate = threshold(base + push, friction) / (slope + gain)
        volts = level - fall * rate
        if abs(volts) > limit_v:
            level, fall, kind = clip(volts, limit_v), 0.0, math.copysign(2.0, volts)
            push, gain = kt / ohm * level, kt / ohm * ke
            rate = threshold(base + push, friction) / (slope + gain)
        amps = (level - (fall + ke) * rate) / ohm
        if abs(amps) > limit_a:
            push, gain, kind = kt * clip(amps, limit_a), 0.0, math.copysign(3.0, amps)
    total = base + push
    if abs(total) <= friction:
        return 0.0, 10.0 * kind, 0.0, 0.0
    rate, direction = threshold(total, friction) / (slope + gain), math.copysign(1.0, total)
    free = (total - pull - direction * friction) / (slope + gain)
    return rate, direction + 10.0 * kind, free, 1.0 / (slope + gain)


@inner
def threshold(value: float, friction: float) -> float:
    """Torque that remains after dry friction."""
    return math.copysign(max(abs(value) - friction, 0.0), value)


@inner
def demand(j: int, dt: float, c: Constants, s: State, q: Commands) -> tuple[float, float]:
    """Voltage of the control loop as (level, fall): level - fall * rate after an implicit step."""
    mode = q.mode[j]
    if mode == MODE_VELOCITY:
        gain = c.velocity_p + c.velocity_i * dt
        return gain * clip(q.goal[j], q.rate_limit[j]) + s.integral[j], gain
    if mode == MODE_POSITION:
        return c.position_p * (s.reference[j] - s.angle[j]), c.position_p * dt
    return c.supply * q.goal[j], 0.0


@inner
def finish_joint(j: int, dt: float, rate: float, c: Constants, s: State, q: Commands) -> None:
    """Store a joint's new rate, angle, current and integrator (held while a limit is active)."""
    mode, limit_a, limit_v = q.mode[j], q.amps_limit[j], c.supply * q.duty_limit[j]
    amps = 0.0
    if mode == MODE_CURRENT:
        volts = clip(clip(q.goal[j], limit_a) * c.ohm[j] + c.ke[j] * rate, limit_v)
        amps = (volts - c.ke[j] * rate) / c.ohm[j]
    elif mode != MODE_OFF:
        level, fall = demand(j, dt, c, s, q)
        wanted = level - fall * rate
        amps = (clip(wanted, limit_v) - c.ke[j] * rate) / c.ohm[j]
        error = clip(q.goal[j], q.rate_limit[j]) - rate
        limited = abs(wanted) > limit_v or abs(amps) > limit_a
        if mode == MODE_VELOCITY and (not limited or error * wanted < 0.0):
            s.integral[j] += c.velocity_i * c.dt * error
        amps = clip(amps, limit_a)
    s.amps[j] = amps
    s.rate[j] = rate
    s.angle[j] += c.dt * rate


@inner
def follow_references(c: Constants, s: State, q: Commands) -> None:
    """Move the reference of every position loop towards its goal, within its rate limit."""
    for j in range(8):
        if q.mode[j] == MODE_POSITION:
            s.reference[j] += clip(q.goal[j] - s.reference[j], q.rate_limit[j] * c.dt)
        else:
            s.reference[j] = s.angle[j]


@inner
def steer_joint(i: int, c: Constants, s: State, q: Commands) -> float:
    """Step one steering joint and, through its play, its wheel; returns the wheel's previous heading.

    These joints have no contact forces, so they use the implicit midpoint rule: the position within the play
    after an overshoot must not depend on the step.
    """
    j = i + 4
    start, dt = s.rate[j], 0.5 * c.dt if q.mode[j] == MODE_POSITION else c.dt
    rate, _, _, _ = motor(j, dt, 0.0, 0.0, c.coulomb[j], c, s, q)
    finish_joint(j, dt, rate, c, s, q)
    if q.mode[j] == MODE_POSITION and rate != 0.0:
        s.rate[j] = 2.0 * rate - start
    before: float = s.heading[i]
    angle = s.angle[j] + c.offset[i]
    s.heading[i] = min(max(before, angle - c.play[i]), angle + c.play[i])
    return before
