"""The physics of the robot on a surface: `n` internal steps on preallocated numbers, nothing else.

Plain Python on indexed numbers, written once: interpreted on lists, or compiled by numba on arrays
(`hil.fakes.plant.compiled`); both give the same figures. `docs/wall.md` describes the model.

* Body: rigid, velocities of the centre of mass in wall axes, so inertia is diagonal and exact.
* Contact of each wheel: bristle z with relaxation length L, z' = s - |r Om| / L z, F = -k z - c s,
  L = C N / k max(1 - eta f, 0.05); at rest it is a spring (stiction, no creep), rolling it creeps by
  the metre. |F| <= mu N by scaling (return mapping). z is kept in wall axes and survives steering.
* Joint: motor with back-EMF, voltage and current limits, Coulomb and viscous friction, firmware loops.
* Backward Euler in velocities; wheel rates are eliminated (their equation is a soft threshold), one
  symmetric 3x3 solve per pass, at most `PASSES` passes for friction cones and motor branches. Every
  part is passive in this scheme, so that no step creates energy.

Joints: drives FL BL BR FR, then steers. All numbers stand in three flat vectors in SI units, at
the places named below: constants `c` (106 + 5 per patch,), state `s` (144,), commands `q` (40,). Named
tuples of arrays were four times slower to pass.
"""

from __future__ import annotations

import math

from hil.vocabulary.geometry import Array

# Modes of a joint.
MODE_OFF, MODE_VELOCITY, MODE_POSITION, MODE_PWM, MODE_CURRENT = range(5)

# Constants `c`: scalars, then four per wheel, the load map (12: N of total, M_y, M_x), eight per joint,
# and at the end five per patch (x_min, y_min, x_max, y_max, factor).
(
    DT, MASS, INERTIA, COM_X, COM_Y, COM_HEIGHT, GRAVITY, PRESS, PRESS_Y, PRESS_X, ADHESION, THRUST,
    THRUST_TORQUE, THRUST_HEIGHT, FRICTION, CREEP_ALONG, CREEP_ACROSS, SOFTENING, STIFFNESS, DAMPING,
    ROLLING, SUPPLY, VELOCITY_P, VELOCITY_I, POSITION_P, FALL_SLIDE,
) = range(26)  # fmt: skip
WHEEL_X, WHEEL_Y, RADIUS, OFFSET, PLAY = range(26, 46, 4)
LOAD_MAP = 46
KT, KE, OHM, JOINT_INERTIA, COULOMB, VISCOUS = range(58, 106, 8)
PATCHES = 106

# State `s`: body (x, y of the centre of mass, heading) and its velocity, wall axes; pose of the origin, with
# its twist and acceleration in body axes; whether it has fallen, how far it has slid with no wheel holding;
# eight per joint; x, y per wheel; four per wheel, of which the last rows are scratch of one step.
BODY, VELOCITY, ORIGIN, TWIST, ACCELERATION, FALLEN, SLID = 0, 3, 6, 9, 12, 14, 15
ANGLE, RATE, AMPS, INTEGRAL, REFERENCE = range(16, 56, 8)
BRISTLE, SLIP = 56, 64
(
    HEADING, USE, LOAD, NEXT_SHARE, SHARE, COSINE, SINE, ARM_X, ARM_Y, GRIP, ALONG, ALONG_SLOPE, ACROSS,
    ACROSS_SLOPE, BRANCH, FREE, COMPLIANCE, SPIN,
) = range(72, 144, 4)  # fmt: skip
STATE_SIZE = 144

# Commands `q`: eight per joint.
MODE, GOAL, RATE_LIMIT, AMPS_LIMIT, DUTY_LIMIT = range(0, 40, 8)
COMMANDS_SIZE = 40

CONSTANTS = STATE_SIZE + COMMANDS_SIZE
"""Where the constants begin in the vector of `advance_all`."""

PASSES = 4


def clip(value: float, limit: float) -> float:
    """Value within +-limit."""
    return min(max(value, -limit), limit)


def motor(
    j: int, dt: float, pull: float, drag: float, friction: float, c: Array, s: Array, q: Array
) -> tuple[float, float, float, float]:
    """Rate of joint `j` after an implicit step `dt` under an outer torque `pull - drag * rate`.

    Returns:
        (rate, branch, free, compliance): rate = free + compliance * pull while the branch holds; a
        branch is a direction (0: stuck, compliance 0) and which limit acts.
    """
    kt, ke, ohm = c[KT + j], c[KE + j], c[OHM + j]
    mode, limit_a, limit_v = q[MODE + j], q[AMPS_LIMIT + j], c[SUPPLY] * q[DUTY_LIMIT + j]
    base = c[JOINT_INERTIA + j] / dt * s[RATE + j] + pull
    slope = c[JOINT_INERTIA + j] / dt + c[VISCOUS + j] + drag
    push, gain, kind = 0.0, 0.0, 0.0
    if mode == MODE_CURRENT:
        push = kt * clip(q[GOAL + j], limit_a)
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


def threshold(value: float, friction: float) -> float:
    """What dry friction leaves of a torque."""
    return math.copysign(max(abs(value) - friction, 0.0), value)


def demand(j: int, dt: float, c: Array, s: Array, q: Array) -> tuple[float, float]:
    """Voltage asked for by the firmware: (level, fall) of level - fall * rate after an implicit step."""
    mode = q[MODE + j]
    if mode == MODE_VELOCITY:
        gain = c[VELOCITY_P] + c[VELOCITY_I] * dt
        return gain * clip(q[GOAL + j], q[RATE_LIMIT + j]) + s[INTEGRAL + j], gain
    if mode == MODE_POSITION:
        return c[POSITION_P] * (s[REFERENCE + j] - s[ANGLE + j]), c[POSITION_P] * dt
    return c[SUPPLY] * q[GOAL + j], 0.0


def finish_joint(j: int, dt: float, rate: float, c: Array, s: Array, q: Array) -> None:
    """Store a joint's new rate, angle, current and integrator (which rests while a limit acts)."""
    mode, limit_a, limit_v = q[MODE + j], q[AMPS_LIMIT + j], c[SUPPLY] * q[DUTY_LIMIT + j]
    amps = 0.0
    if mode == MODE_CURRENT:
        volts = clip(clip(q[GOAL + j], limit_a) * c[OHM + j] + c[KE + j] * rate, limit_v)
        amps = (volts - c[KE + j] * rate) / c[OHM + j]
    elif mode != MODE_OFF:
        level, fall = demand(j, dt, c, s, q)
        wanted = level - fall * rate
        amps = (clip(wanted, limit_v) - c[KE + j] * rate) / c[OHM + j]
        error = clip(q[GOAL + j], q[RATE_LIMIT + j]) - rate
        limited = abs(wanted) > limit_v or abs(amps) > limit_a
        if mode == MODE_VELOCITY and (not limited or error * wanted < 0.0):
            s[INTEGRAL + j] += c[VELOCITY_I] * c[DT] * error
        amps = clip(amps, limit_a)
    s[AMPS + j] = amps
    s[RATE + j] = rate
    s[ANGLE + j] += c[DT] * rate


def follow_references(c: Array, s: Array, q: Array) -> None:
    """Move the reference of every position loop towards its goal, as fast as its limit allows."""
    for j in range(8):
        if q[MODE + j] == MODE_POSITION:
            s[REFERENCE + j] += clip(q[GOAL + j] - s[REFERENCE + j], q[RATE_LIMIT + j] * c[DT])
        else:
            s[REFERENCE + j] = s[ANGLE + j]


def steer_joint(i: int, c: Array, s: Array, q: Array) -> float:
    """Turn one steering joint and, through its play, its wheel; returns the wheel's heading before.

    No contact force reaches these joints, so they go by the implicit midpoint rule: where an overshoot
    leaves a wheel within its play must not depend on the step.
    """
    j = i + 4
    start, dt = s[RATE + j], 0.5 * c[DT] if q[MODE + j] == MODE_POSITION else c[DT]
    rate, _, _, _ = motor(j, dt, 0.0, 0.0, c[COULOMB + j], c, s, q)
    finish_joint(j, dt, rate, c, s, q)
    if q[MODE + j] == MODE_POSITION and rate != 0.0:
        s[RATE + j] = 2.0 * rate - start
    before: float = s[HEADING + i]
    angle = s[ANGLE + j] + c[OFFSET + i]
    s[HEADING + i] = min(max(before, angle - c[PLAY + i]), angle + c[PLAY + i])
    return before


def steer(c: Array, s: Array, q: Array) -> None:
    """Turn the steering joints and, through their play, the wheels; contact directions at mid-step."""
    middle = s[BODY + 2] + 0.5 * c[DT] * s[VELOCITY + 2]
    for i in range(4):
        before = steer_joint(i, c, s, q)
        direction = middle + 0.5 * (before + s[HEADING + i])
        s[COSINE + i], s[SINE + i] = math.cos(direction), math.sin(direction)
    cosine, sine = math.cos(middle), math.sin(middle)
    for i in range(4):
        x, y = c[WHEEL_X + i] - c[COM_X], c[WHEEL_Y + i] - c[COM_Y]
        s[ARM_X + i], s[ARM_Y + i] = cosine * x - sine * y, sine * x + cosine * y


def loads(adhesion_factor: float, c: Array, s: Array) -> None:
    """Normal loads from statics; a wheel does not pull. The robot falls when it tips or is let go.

    It tips when what presses it on acts outside of the wheels.
    """
    cosine, sine = math.cos(s[BODY + 2]), math.sin(s[BODY + 2])
    weight = c[MASS] * c[GRAVITY]
    total = c[ADHESION] * adhesion_factor + c[PRESS]
    moment_y = c[PRESS_Y] - c[COM_HEIGHT] * weight * cosine + c[THRUST_HEIGHT] * c[THRUST]
    moment_x = c[PRESS_X] + c[COM_HEIGHT] * weight * sine
    positive, tips = 0.0, False
    for i in range(4):
        n = (
            c[LOAD_MAP + 3 * i] * total
            + c[LOAD_MAP + 3 * i + 1] * moment_y
            + c[LOAD_MAP + 3 * i + 2] * moment_x
        )
        s[LOAD + i] = max(n, 0.0)
        positive += s[LOAD + i]
        x, y, after = c[WHEEL_X + i], c[WHEEL_Y + i], (i + 1) % 4
        edge_x, edge_y = c[WHEEL_X + after] - x, c[WHEEL_Y + after] - y
        tips = tips or edge_x * (moment_x - total * y) < edge_y * (moment_y - total * x)
    if total <= 0.0 or tips:
        s[FALLEN] = 1.0
        total, positive = 0.0, 1.0
    for i in range(4):
        s[LOAD + i] *= total / positive


def contacts(c: Array, s: Array) -> None:
    """Bristle forces per slip velocity, wheel frame, for the coming step."""
    for i in range(4):
        factor = 1.0
        x, y = s[BODY] + s[ARM_X + i], s[BODY + 1] + s[ARM_Y + i]
        for k in range(PATCHES, len(c), 5):
            if c[k] <= x < c[k + 2] and c[k + 1] <= y < c[k + 3]:
                factor = c[k + 4]
                break
        load, cosine, sine = s[LOAD + i], s[COSINE + i], s[SINE + i]
        s[GRIP + i] = c[FRICTION] * factor * load
        length = load / c[STIFFNESS] * max(1.0 - c[SOFTENING] * s[USE + i], 0.05)
        rolled = abs(c[RADIUS + i] * s[RATE + i]) * c[DT]
        keep_along = 1.0 / (1.0 + rolled / (c[CREEP_ALONG] * length)) if load > 0.0 else 0.0
        keep_across = 1.0 / (1.0 + rolled / (c[CREEP_ACROSS] * length)) if load > 0.0 else 0.0
        pressed = 1.0 if load > 0.0 else 0.0
        z_along = cosine * s[BRISTLE + 2 * i] + sine * s[BRISTLE + 2 * i + 1]
        z_across = cosine * s[BRISTLE + 2 * i + 1] - sine * s[BRISTLE + 2 * i]
        s[ALONG + i] = c[STIFFNESS] * keep_along * z_along
        s[ACROSS + i] = c[STIFFNESS] * keep_across * z_across
        s[ALONG_SLOPE + i] = c[STIFFNESS] * keep_along * c[DT] + pressed * c[DAMPING]
        s[ACROSS_SLOPE + i] = c[STIFFNESS] * keep_across * c[DT] + pressed * c[DAMPING]
        s[BRANCH + i] = -99.0


def judge(vx: float, vy: float, turn: float, c: Array, s: Array, q: Array) -> bool:
    """Wheel rates, motor branches and cone shares that go with a body velocity; whether any changed."""
    changed = False
    for i in range(4):
        r, share = c[RADIUS + i], s[SHARE + i]
        px, py = vx - turn * s[ARM_Y + i], vy + turn * s[ARM_X + i]
        along, across = s[COSINE + i] * px + s[SINE + i] * py, s[COSINE + i] * py - s[SINE + i] * px
        pull = r * share * (s[ALONG + i] + s[ALONG_SLOPE + i] * along)
        friction = c[COULOMB + i] + c[ROLLING] * s[LOAD + i] * r
        drag = r * r * share * s[ALONG_SLOPE + i]
        s[SPIN + i], branch, s[FREE + i], s[COMPLIANCE + i] = motor(i, c[DT], pull, drag, friction, c, s, q)
        s[SLIP + 2 * i], s[SLIP + 2 * i + 1] = along - r * s[SPIN + i], across
        force = math.hypot(
            s[ALONG + i] + s[ALONG_SLOPE + i] * s[SLIP + 2 * i], s[ACROSS + i] + s[ACROSS_SLOPE + i] * across
        )
        s[NEXT_SHARE + i] = s[GRIP + i] / force if force > s[GRIP + i] else 1.0
        if branch != s[BRANCH + i] or abs(s[NEXT_SHARE + i] - share) > 1e-6 * share:
            changed = True
        s[BRANCH + i] = branch
    return changed


def solve(c: Array, s: Array) -> tuple[float, float, float]:
    """Velocity of the centre of mass (wall axes) and turn rate after the step, wheels eliminated."""
    middle = s[BODY + 2] + 0.5 * c[DT] * s[VELOCITY + 2]
    held = 1.0 - s[FALLEN]
    thrust = held * c[THRUST]
    m00, m11, m22 = c[MASS] / c[DT], c[MASS] / c[DT], c[INERTIA] / c[DT]
    m01, m02, m12 = 0.0, 0.0, 0.0
    b0 = m00 * s[VELOCITY] - c[MASS] * c[GRAVITY] + thrust * math.cos(middle)
    b1 = m11 * s[VELOCITY + 1] + thrust * math.sin(middle)
    b2 = m22 * s[VELOCITY + 2] + thrust * c[COM_Y] + held * c[THRUST_TORQUE]
    for i in range(4):
        r, share, cosine, sine = c[RADIUS + i], s[SHARE + i], s[COSINE + i], s[SINE + i]
        slope = share * s[ALONG_SLOPE + i]
        kept = 1.0 - r * r * slope * s[COMPLIANCE + i]
        gain, push = kept * slope, slope * r * s[FREE + i] - kept * share * s[ALONG + i]
        lever = s[ARM_X + i] * sine - s[ARM_Y + i] * cosine
        m00, m01, m11 = m00 + gain * cosine * cosine, m01 + gain * cosine * sine, m11 + gain * sine * sine
        m02, m12, m22 = m02 + gain * cosine * lever, m12 + gain * sine * lever, m22 + gain * lever * lever
        b0, b1, b2 = b0 + push * cosine, b1 + push * sine, b2 + push * lever
        gain, push = share * s[ACROSS_SLOPE + i], -share * s[ACROSS + i]
        lever = s[ARM_X + i] * cosine + s[ARM_Y + i] * sine
        m00, m01, m11 = m00 + gain * sine * sine, m01 - gain * cosine * sine, m11 + gain * cosine * cosine
        m02, m12, m22 = m02 - gain * sine * lever, m12 + gain * cosine * lever, m22 + gain * lever * lever
        b0, b1, b2 = b0 - push * sine, b1 + push * cosine, b2 + push * lever
    l10, l20 = m01 / m00, m02 / m00
    d1, e12 = m11 - l10 * m01, m12 - l20 * m01
    l21 = e12 / d1
    y1 = b1 - l10 * b0
    turn = (b2 - l20 * b0 - l21 * y1) / (m22 - l20 * m02 - l21 * e12)
    vy = y1 / d1 - l21 * turn
    return b0 / m00 - l10 * vy - l20 * turn, vy, turn


def move(vx: float, vy: float, turn: float, c: Array, s: Array, q: Array) -> None:
    """Accept a solved step: bristles, wheels, body; a robot that slides away has fallen."""
    holding = 0
    for i in range(4):
        share, load = s[SHARE + i], s[LOAD + i]
        damping = c[DAMPING] if load > 0.0 else 0.0
        slip_along, slip_across = s[SLIP + 2 * i], s[SLIP + 2 * i + 1]
        along = share * (s[ALONG + i] + (s[ALONG_SLOPE + i] - damping) * slip_along) / c[STIFFNESS]
        across = share * (s[ACROSS + i] + (s[ACROSS_SLOPE + i] - damping) * slip_across) / c[STIFFNESS]
        s[BRISTLE + 2 * i] = s[COSINE + i] * along - s[SINE + i] * across
        s[BRISTLE + 2 * i + 1] = s[SINE + i] * along + s[COSINE + i] * across
        force = c[STIFFNESS] * math.hypot(along, across)
        s[USE + i] = min(force / s[GRIP + i], 1.0) if s[GRIP + i] > 0.0 else 1.0
        holding += 1 if load > 0.0 and share == 1.0 else 0
        finish_joint(i, c[DT], s[SPIN + i], c, s, q)
    s[SLID] = s[SLID] + c[DT] * math.hypot(vx, vy) if holding == 0 else 0.0
    if s[SLID] > c[FALL_SLIDE] and c[GRAVITY] > 0.0:
        s[FALLEN] = 1.0
    s[VELOCITY], s[VELOCITY + 1], s[VELOCITY + 2] = vx, vy, turn
    s[BODY], s[BODY + 1], s[BODY + 2] = (
        s[BODY] + c[DT] * vx,
        s[BODY + 1] + c[DT] * vy,
        s[BODY + 2] + c[DT] * turn,
    )


def origin_velocity(c: Array, s: Array) -> tuple[float, float]:
    """Velocity of the body's origin, wall axes."""
    cosine, sine = math.cos(s[BODY + 2]), math.sin(s[BODY + 2])
    x, y = cosine * c[COM_X] - sine * c[COM_Y], sine * c[COM_X] + cosine * c[COM_Y]
    return s[VELOCITY] + s[VELOCITY + 2] * y, s[VELOCITY + 1] - s[VELOCITY + 2] * x


def look_from_origin(s: Array, x: float, y: float) -> None:
    """Pose of the body's origin, and its twist in body axes, in which `s` follows the point (x, y)."""
    cosine, sine = math.cos(s[BODY + 2]), math.sin(s[BODY + 2])
    vx, vy, turn = s[VELOCITY], s[VELOCITY + 1], s[VELOCITY + 2]
    s[ORIGIN], s[ORIGIN + 1] = s[BODY] - (cosine * x - sine * y), s[BODY + 1] - (sine * x + cosine * y)
    s[ORIGIN + 2] = s[BODY + 2]
    s[TWIST] = cosine * vx + sine * vy + turn * y
    s[TWIST + 1] = cosine * vy - sine * vx - turn * x
    s[TWIST + 2] = turn


def advance(n: int, adhesion_factor: float, c: Array, s: Array, q: Array) -> None:
    """Integrate `n` steps; `acceleration` is the origin's mean over the last one, body axes."""
    before_x, before_y = 0.0, 0.0
    for k in range(n):
        if k == n - 1:
            before_x, before_y = origin_velocity(c, s)
        follow_references(c, s, q)
        steer(c, s, q)
        loads(adhesion_factor if s[FALLEN] == 0.0 else 0.0, c, s)
        contacts(c, s)
        vx, vy, turn = s[VELOCITY], s[VELOCITY + 1], s[VELOCITY + 2]
        for passes in range(PASSES + 1):
            for i in range(4):
                s[SHARE + i] = s[NEXT_SHARE + i]
            if not judge(vx, vy, turn, c, s, q) and passes > 0:
                break
            if passes == PASSES:
                break
            vx, vy, turn = solve(c, s)
        move(vx, vy, turn, c, s, q)
    if n > 0:
        cosine, sine = math.cos(s[BODY + 2]), math.sin(s[BODY + 2])
        after_x, after_y = origin_velocity(c, s)
        x, y = (after_x - before_x) / c[DT], (after_y - before_y) / c[DT]
        s[ACCELERATION], s[ACCELERATION + 1] = cosine * x + sine * y, cosine * y - sine * x
    look_from_origin(s, c[COM_X], c[COM_Y])


def advance_all(n: int, adhesion_factor: float, numbers: Array) -> None:
    """As `advance`, of one vector (184 + n,): state, commands, constants. An argument takes time, too."""
    state, commands, constants = numbers[:STATE_SIZE], numbers[STATE_SIZE:CONSTANTS], numbers[CONSTANTS:]
    advance(n, adhesion_factor, constants, state, commands)
