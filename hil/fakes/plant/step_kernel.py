"""Physics of the robot on a surface: `n` internal steps on preallocated arrays.

`docs/wall.md` describes the model.

* Body: rigid, velocities of the centre of mass in wall axes, so inertia is diagonal and exact.
* Contact of each wheel: bristle z with relaxation length L, z' = s - |r Om| / L z, F = -k z - c s,
  L = C N / k max(1 - eta f, 0.05); at rest it is a spring (stiction, no creep), rolling it creeps by
  the metre. |F| <= mu N by scaling (return mapping). z is kept in wall axes and survives steering.
* Joint: motor with back-EMF, voltage and current limits, Coulomb and viscous friction, firmware loops.
* Backward Euler in velocities; wheel rates are eliminated (their equation is a soft threshold), one
  symmetric 3x3 solve per pass, at most `PASSES` passes for friction cones and motor branches. Every
  part is passive in this scheme, so that no step creates energy.

Constants `c`, state `s` and commands `q` are those of `hil.fakes.plant.named_numbers`.
"""

import math

from hil.core.named_records import Records
from hil.fakes.plant.joints import finish_joint, follow_references, motor, steer_joint
from hil.fakes.plant.named_numbers import Commands, Constants, State
from hil.support.numba_jit import inner, kernel

PASSES = 4


@inner
def steer(c: Constants, s: State, q: Commands) -> None:
    """Step the steering joints and, through their play, the wheels; contact directions at mid-step."""
    middle = s.body[2] + 0.5 * c.dt * s.velocity[2]
    for i in range(4):
        before = steer_joint(i, c, s, q)
        direction = middle + 0.5 * (before + s.heading[i])
        s.cosine[i], s.sine[i] = math.cos(direction), math.sin(direction)
    cosine, sine = math.cos(middle), math.sin(middle)
    for i in range(4):
        x, y = c.wheel_x[i] - c.com_x, c.wheel_y[i] - c.com_y
        s.arm_x[i], s.arm_y[i] = cosine * x - sine * y, sine * x + cosine * y


@inner
def loads(adhesion_factor: float, c: Constants, s: State) -> None:
    """Compute normal loads from statics; a wheel cannot pull. The robot falls when it tips or is released.

    It tips when the resulting normal force acts outside of the wheels' polygon.
    """
    cosine, sine = math.cos(s.body[2]), math.sin(s.body[2])
    weight = c.mass * c.gravity
    total = c.adhesion * adhesion_factor + c.press
    moment_y = c.press_y - c.com_height * weight * cosine + c.thrust_height * c.thrust
    moment_x = c.press_x + c.com_height * weight * sine
    positive, tips = 0.0, False
    for i in range(4):
        n = c.load_map[3 * i] * total + c.load_map[3 * i + 1] * moment_y + c.load_map[3 * i + 2] * moment_x
        s.load[i] = max(n, 0.0)
        positive += s.load[i]
        x, y, after = c.wheel_x[i], c.wheel_y[i], (i + 1) % 4
        edge_x, edge_y = c.wheel_x[after] - x, c.wheel_y[after] - y
        tips = tips or edge_x * (moment_x - total * y) < edge_y * (moment_y - total * x)
    if total <= 0.0 or tips:
        s.fallen = 1.0
        total, positive = 0.0, 1.0
    for i in range(4):
        s.load[i] *= total / positive


@inner
def friction_factor(patches: Records, x: float, y: float) -> float:
    """Friction at a point of the surface relative to that of the surface."""
    for k in range(len(patches)):
        patch = patches[k]
        if patch.x_min <= x < patch.x_max and patch.y_min <= y < patch.y_max:
            factor: float = patch.friction_factor
            return factor
    return 1.0


@inner
def contacts(patches: Records, c: Constants, s: State) -> None:
    """Bristle forces per slip velocity, wheel frame, for the coming step."""
    for i in range(4):
        factor = friction_factor(patches, s.body[0] + s.arm_x[i], s.body[1] + s.arm_y[i])
        load, cosine, sine = s.load[i], s.cosine[i], s.sine[i]
        s.grip[i] = c.friction * factor * load
        length = load / c.stiffness * max(1.0 - c.softening * s.use[i], 0.05)
        rolled = abs(c.radius[i] * s.rate[i]) * c.dt
        keep_along = 1.0 / (1.0 + rolled / (c.creep_along * length)) if load > 0.0 else 0.0
        keep_across = 1.0 / (1.0 + rolled / (c.creep_across * length)) if load > 0.0 else 0.0
        pressed = 1.0 if load > 0.0 else 0.0
        z_along = cosine * s.bristle[2 * i] + sine * s.bristle[2 * i + 1]
        z_across = cosine * s.bristle[2 * i + 1] - sine * s.bristle[2 * i]
        s.along[i] = c.stiffness * keep_along * z_along
        s.across[i] = c.stiffness * keep_across * z_across
        s.along_slope[i] = c.stiffness * keep_along * c.dt + pressed * c.damping
        s.across_slope[i] = c.stiffness * keep_across * c.dt + pressed * c.damping
        s.branch[i] = -99.0


@inner
def judge(vx: float, vy: float, turn: float, c: Constants, s: State, q: Commands) -> bool:
    """Compute wheel rates, motor branches and cone factors for a body velocity; whether any changed."""
    changed = False
    for i in range(4):
        r, share = c.radius[i], s.share[i]
        px, py = vx - turn * s.arm_y[i], vy + turn * s.arm_x[i]
        along, across = s.cosine[i] * px + s.sine[i] * py, s.cosine[i] * py - s.sine[i] * px
        pull = r * share * (s.along[i] + s.along_slope[i] * along)
        friction = c.coulomb[i] + c.rolling * s.load[i] * r
        drag = r * r * share * s.along_slope[i]
        s.spin[i], branch, s.free[i], s.compliance[i] = motor(i, c.dt, pull, drag, friction, c, s, q)
        s.slip[2 * i], s.slip[2 * i + 1] = along - r * s.spin[i], across
        force = math.hypot(
            s.along[i] + s.along_slope[i] * s.slip[2 * i], s.across[i] + s.across_slope[i] * across
        )
        s.next_share[i] = s.grip[i] / force if force > s.grip[i] else 1.0
        if branch != s.branch[i] or abs(s.next_share[i] - share) > 1e-6 * share:
            changed = True
        s.branch[i] = branch
    return changed


@inner
def solve(c: Constants, s: State) -> tuple[float, float, float]:
    """Solve for velocity of the centre of mass (wall axes) and turn rate, with the wheels eliminated."""
    middle = s.body[2] + 0.5 * c.dt * s.velocity[2]
    held = 1.0 - s.fallen
    thrust = held * c.thrust
    m00, m11, m22 = c.mass / c.dt, c.mass / c.dt, c.inertia / c.dt
    m01, m02, m12 = 0.0, 0.0, 0.0
    b0 = m00 * s.velocity[0] - c.mass * c.gravity + thrust * math.cos(middle)
    b1 = m11 * s.velocity[1] + thrust * math.sin(middle)
    b2 = m22 * s.velocity[2] + thrust * c.com_y + held * c.thrust_torque
    for i in range(4):
        r, share, cosine, sine = c.radius[i], s.share[i], s.cosine[i], s.sine[i]
        slope = share * s.along_slope[i]
        kept = 1.0 - r * r * slope * s.compliance[i]
        gain, push = kept * slope, slope * r * s.free[i] - kept * share * s.along[i]
        lever = s.arm_x[i] * sine - s.arm_y[i] * cosine
        m00, m01, m11 = m00 + gain * cosine * cosine, m01 + gain * cosine * sine, m11 + gain * sine * sine
        m02, m12, m22 = m02 + gain * cosine * lever, m12 + gain * sine * lever, m22 + gain * lever * lever
        b0, b1, b2 = b0 + push * cosine, b1 + push * sine, b2 + push * lever
        gain, push = share * s.across_slope[i], -share * s.across[i]
        lever = s.arm_x[i] * cosine + s.arm_y[i] * sine
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


@inner
def move(vx: float, vy: float, turn: float, c: Constants, s: State, q: Commands) -> None:
    """Apply a solved step to bristles, wheels and body; detect a fall by sliding."""
    holding = 0
    for i in range(4):
        share, load = s.share[i], s.load[i]
        damping = c.damping if load > 0.0 else 0.0
        slip_along, slip_across = s.slip[2 * i], s.slip[2 * i + 1]
        along = share * (s.along[i] + (s.along_slope[i] - damping) * slip_along) / c.stiffness
        across = share * (s.across[i] + (s.across_slope[i] - damping) * slip_across) / c.stiffness
        s.bristle[2 * i] = s.cosine[i] * along - s.sine[i] * across
        s.bristle[2 * i + 1] = s.sine[i] * along + s.cosine[i] * across
        force = c.stiffness * math.hypot(along, across)
        s.use[i] = min(force / s.grip[i], 1.0) if s.grip[i] > 0.0 else 1.0
        holding += 1 if load > 0.0 and share == 1.0 else 0
        finish_joint(i, c.dt, s.spin[i], c, s, q)
    s.slid = s.slid + c.dt * math.hypot(vx, vy) if holding == 0 else 0.0
    if s.slid > c.fall_slide and c.gravity > 0.0:
        s.fallen = 1.0
    s.velocity[0], s.velocity[1], s.velocity[2] = vx, vy, turn
    s.body[0], s.body[1], s.body[2] = (s.body[0] + c.dt * vx, s.body[1] + c.dt * vy, s.body[2] + c.dt * turn)


@inner
def origin_velocity(c: Constants, s: State) -> tuple[float, float]:
    """Velocity of the body's origin, wall axes."""
    cosine, sine = math.cos(s.body[2]), math.sin(s.body[2])
    x, y = cosine * c.com_x - sine * c.com_y, sine * c.com_x + cosine * c.com_y
    return s.velocity[0] + s.velocity[2] * y, s.velocity[1] - s.velocity[2] * x


@inner
def look_from_origin(s: State, x: float, y: float) -> None:
    """Set the pose of the body's origin and its twist in body axes; (x, y) is the tracked point of `s`."""
    cosine, sine = math.cos(s.body[2]), math.sin(s.body[2])
    vx, vy, turn = s.velocity[0], s.velocity[1], s.velocity[2]
    pose, twist = s.origin.pose, s.origin.twist
    pose[0], pose[1] = s.body[0] - (cosine * x - sine * y), s.body[1] - (sine * x + cosine * y)
    pose[2] = s.body[2]
    twist[0] = cosine * vx + sine * vy + turn * y
    twist[1] = cosine * vy - sine * vx - turn * x
    twist[2] = turn


@kernel
def advance(robots: Records, patches: Records, n: int, adhesion_factor: float) -> None:
    """Integrate `n` steps; `acceleration` is the origin's mean over the last one, body axes.

    Args:
        robots: array (1,) of `Robot`; its state changes.
        patches: array (m,) of `PatchRecord`.
        n: steps, may be 0.
        adhesion_factor: factor on the fan's force.
    """
    robot = robots[0]
    c, s, q = robot.constants, robot.state, robot.commands
    before_x, before_y = 0.0, 0.0
    for k in range(n):
        if k == n - 1:
            before_x, before_y = origin_velocity(c, s)
        follow_references(c, s, q)
        steer(c, s, q)
        loads(adhesion_factor if s.fallen == 0.0 else 0.0, c, s)
        contacts(patches, c, s)
        vx, vy, turn = s.velocity[0], s.velocity[1], s.velocity[2]
        for passes in range(PASSES + 1):
            for i in range(4):
                s.share[i] = s.next_share[i]
            if not judge(vx, vy, turn, c, s, q) and passes > 0:
                break
            if passes == PASSES:
                break
            vx, vy, turn = solve(c, s)
        move(vx, vy, turn, c, s, q)
    if n > 0:
        cosine, sine = math.cos(s.body[2]), math.sin(s.body[2])
        after_x, after_y = origin_velocity(c, s)
        x, y = (after_x - before_x) / c.dt, (after_y - before_y) / c.dt
        s.origin.acceleration[0], s.origin.acceleration[1] = cosine * x + sine * y, cosine * y - sine * x
    look_from_origin(s, c.com_x, c.com_y)
