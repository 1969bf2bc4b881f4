"""Simulator of recordings with known hidden parameters: a robot whose wheels differ from the nominal ones.

The robot is commanded through the nominal inverse kinematics, but has its own wheel positions, radii,
steering zeros and wheel loads. Its motion follows from force balance at the four contacts, never from the
odometry formula. Under `viscous` contact each wheel pulls in proportion to its load and slip; under `coulomb`
contact the force does not grow with slip; under `creep` contact it grows with slip per distance rolled; under
`elastic` contact each tyre is a spring that slip winds up and rolling unwinds. The recorded signals have the
errors measured on the real robot (arXiv 2509.04016): 12-bit counts, a velocity register that lags 52 ms and
truncates half a unit, steering dither, capture noise, stamp jitter.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from hil.core.geometry import Array
from hil.datasets.cleaning import Log
from hil.datasets.nominal_robot import Nominal
from hil.datasets.recording_names import MOTIONS as MOTIONS
from hil.datasets.wheel_log import Recording, build_recording
from hil.robot.contact_laws import creep_motion, least_dissipation
from hil.robot.kinematics import WheelGeometry, inverse, projection, wheel_vectors
from hil.robot.odometry import integrate

OTHER_MOTIONS = ("diagonal", "arc", "curl", "scan")

_STEP_S = 0.008
_REST_S = 1.0
_COUNT_RAD = 2.0 * np.pi / 4096.0
_RATE_UNIT_RAD_S = 0.0239691
_RATE_LAG_S = 0.052
_WHEEL_LAG_S = 0.05
_RELAXATION_M = 0.01
_DITHER_RAD = np.radians(0.03)


@dataclass(frozen=True)
class HiddenRobot:
    """True parameters, which the calibration does not know.

    Attributes:
        geometry: true wheel positions, radii and steering zeros.
        load: (4,) relative normal loads, mean 1.
        contact: `viscous`, `coulomb`, `creep` or `elastic`.
        ratio: sideways over lengthwise stiffness of the tyres of `creep` and `elastic`.
        nominal: nominal robot, with which the commands are computed.
    """

    geometry: WheelGeometry
    load: Array
    contact: str = "viscous"
    ratio: float = 1.0
    nominal: Nominal = field(default_factory=Nominal)

    def twist_correction(self, nominal: WheelGeometry) -> Array:
        """True C (3, 3) for viscous contact: actual twist = C times the twist of nominal odometry."""
        p = projection(self.geometry.x_m, self.geometry.y_m)
        weight = np.repeat(self.load, 2)
        pull = np.linalg.solve(p.T @ (weight[:, None] * p), p.T * weight)
        u = np.empty((3, 8))
        q = (nominal.projection() / np.repeat(nominal.radius_m, 2)[:, None]).T
        c = self.geometry.radius_m * np.cos(self.geometry.steering_zero_rad)
        s = self.geometry.radius_m * np.sin(self.geometry.steering_zero_rad)
        u[:, 0::2] = c * q[:, 0::2] + s * q[:, 1::2]
        u[:, 1::2] = c * q[:, 1::2] - s * q[:, 0::2]
        return np.asarray(pull @ u.T, dtype=np.float64)


def hidden_robot(seed: int, *, contact: str = "viscous", nominal: Nominal | None = None) -> HiddenRobot:
    """Random robot: lengths up to 3 % and radii 2.5 % off, steering zeros of 1 to 2 deg, uneven loads.

    Sideways its tyres have 0.4 to 1 times the lengthwise stiffness.

    Args:
        seed: seed of the random numbers.
        contact: `viscous`, `coulomb`, `creep` or `elastic`.
        nominal: nominal robot, the CAD model by default; loads vary about its loads.
    """
    rng = np.random.default_rng([seed, 1])
    paper = nominal if nominal is not None else Nominal()
    cad = paper.geometry
    zero = rng.uniform(1.0, 2.0, 4) * rng.choice([-1.0, 1.0], 4)
    zero -= zero.mean()
    return HiddenRobot(
        WheelGeometry(
            cad.x_m * (1 + rng.uniform(-0.03, 0.03, 4)),
            cad.y_m * (1 + rng.uniform(-0.03, 0.03, 4)),
            cad.radius_m * (1 + rng.uniform(-0.025, 0.025, 4)),
            np.radians(zero),
        ),
        cad.load * rng.uniform(0.85, 1.15, 4),
        contact,
        rng.uniform(0.4, 1.0),
        paper,
    )


def commanded_twist(motion: str, t_s: Array) -> Array:
    """Commanded body twist (n, 3) of a motion at times since its start; zero outside."""
    v, w = 0.05, 0.157
    shapes = {
        "line_x": (20.0, (v, 0, 0)),
        "line_y": (20.0, (0, v, 0)),
        "circle_ccw": (np.pi / v, (v, 0, 2 * v)),
        "circle_cw": (np.pi / v, (v, 0, -2 * v)),
        "rotation_ccw": (2 * np.pi / w, (0, 0, w)),
        "rotation_cw": (2 * np.pi / w, (0, 0, -w)),
        "diagonal": (20.0, (0.035, 0.035, 0)),
        "arc": (20.0, (0.04, -0.02, 0.05)),
        "curl": (16.0, (-0.03, 0.03, -0.12)),
        "scan": (24.0, (v, 0, 0)),
    }
    duration_s, twist = shapes[motion]
    inside = (t_s >= 0) & (t_s <= duration_s)
    out = np.where(inside[:, None], np.array(twist, dtype=np.float64), 0.0)
    if motion == "scan":
        lane = np.floor(t_s / 6.0)
        out *= np.where(lane % 2 == 0, 1.0, -1.0)[:, None]
        cross = (t_s % 6.0) > 4.5
        out[cross & inside] = (0.0, 0.03, 0.0)
    return out


def duration_s(motion: str) -> float:
    """Duration of a motion, s, including the rests before and after."""
    probe = np.arange(0.0, 90.0, 0.1)
    moving = np.any(commanded_twist(motion, probe) != 0.0, axis=1)
    return float(probe[moving][-1]) + 2 * _REST_S


def simulate(
    robot: HiddenRobot,
    motion: str,
    name: str,
    rng: np.random.Generator,
    *,
    run_to_run: float = 1.0,
    slip_bursts: int = 0,
    corrupted: bool = False,
) -> Recording:
    """Simulate one recording.

    Args:
        robot: hidden truth.
        motion: one of `MOTIONS` or `OTHER_MOTIONS`.
        name: name of the recording.
        rng: source of the noise.
        run_to_run: scale of the differences from run to run: 0.06 deg and 1 mm per metre, 0.05 % of length.
        slip_bursts: number of times that the body slides for a second, by millimetres.
        corrupted: True for a wheel that slips for a third of the run and a capture system that jumps.
    """
    cad = robot.nominal.geometry
    t_s = np.arange(0.0, duration_s(motion), _STEP_S)
    speed, steering = _commands(robot.nominal, commanded_twist(motion, t_s - _REST_S))
    rate = _lag(speed / cad.radius_m, _WHEEL_LAG_S)
    heading = steering + rng.normal(0.0, _DITHER_RAD, steering.shape)
    pull_rate = rate.copy()
    if corrupted:
        third = slice(len(t_s) // 3, 2 * len(t_s) // 3)
        pull_rate[third, 0] *= 0.4
    u = wheel_vectors(
        0.5 * (pull_rate[1:] + pull_rate[:-1]) * _STEP_S * robot.geometry.radius_m,
        0.5 * (heading[1:] + heading[:-1]) - robot.geometry.steering_zero_rad,
    )
    body = _contact(robot, u)
    if run_to_run > 0:
        body = _perturb(body, run_to_run * rng.normal(0.0, 1.0, 3))
    for _ in range(slip_bursts):
        start = int(rng.uniform(0.1, 0.85) * len(body))
        window = slice(start, start + round(1.0 / _STEP_S))
        body[window] += rng.normal(0.0, 1.0, 3) * np.array([4e-3, 4e-3, 8e-3]) * _STEP_S
    start_pose = np.r_[rng.normal(0, 1e-3, 2), rng.normal(0, 5e-3)]
    return _record(
        robot.nominal,
        name,
        motion,
        t_s,
        rate,
        heading,
        integrate(start_pose, body),
        rng=rng,
        corrupted=corrupted,
    )


def _perturb(body: Array, draw: Array) -> Array:
    """Add an error that is constant within a run: scale, sideways and heading drift per metre rolled."""
    step_m = np.hypot(body[:, 0], body[:, 1]) + 0.16 * np.abs(body[:, 2])
    scaled = body * (1.0 + 5e-4 * draw[0])
    sideways = 1e-3 * draw[1]
    turned = scaled + sideways * np.column_stack([-scaled[:, 1], scaled[:, 0], np.zeros(len(body))])
    turned[:, 2] += 1e-3 * draw[2] * step_m
    return np.asarray(turned, dtype=np.float64)


def _commands(nominal: Nominal, twist: Array) -> tuple[Array, Array]:
    """Signed wheel speeds and continuous steering within the limit; angles are held at rest."""
    speed, steering = inverse(nominal.geometry, twist)
    moving = np.any(twist != 0.0, axis=1)
    flip = np.abs(steering) > nominal.steering_limit_rad
    steering = np.where(flip, steering - np.sign(steering) * np.pi, steering)
    speed = np.where(flip, -speed, speed)
    index = np.maximum.accumulate(np.where(moving, np.arange(len(moving)), 0))
    index[: int(np.argmax(moving))] = int(np.argmax(moving))
    return speed, np.asarray(steering[index], dtype=np.float64)


def _lag(values: Array, tau_s: float) -> Array:
    """First-order lag of each column, initialised at its first value."""
    from scipy.signal import lfilter

    a = float(np.exp(-_STEP_S / tau_s))
    out = lfilter([1 - a], [1, -a], values, axis=0, zi=a * values[:1])[0]
    return np.asarray(out, dtype=np.float64)


def _contact(robot: HiddenRobot, u: Array) -> Array:
    p = projection(robot.geometry.x_m, robot.geometry.y_m)
    if robot.contact in ("coulomb", "creep"):
        moving = np.any(np.abs(u) > 1e-9, axis=1)
        body = np.zeros((len(u), 3))
        if robot.contact == "coulomb":
            body[moving] = least_dissipation(p, u[moving], robot.load)
        else:
            body[moving] = creep_motion(p, u[moving], robot.load, robot.ratio)
        return body
    if robot.contact == "elastic":
        return _springs(robot, p, u)
    weight = np.repeat(robot.load, 2)
    return np.asarray(u @ np.linalg.solve(p.T @ (weight[:, None] * p), p.T * weight).T, dtype=np.float64)


def _springs(robot: HiddenRobot, p: Array, u: Array) -> Array:
    """Body motion (n, 3) on tyres that slip winds up and rolling unwinds over `_RELAXATION_M`.

    In every step the forces of the springs balance; their deflection carries over to the next step.
    """
    ways = u.reshape(len(u), 4, 2)
    rolled_m = np.linalg.norm(ways, axis=2)
    along = ways / np.maximum(rolled_m, 1e-12)[..., None]
    unwound = 1.0 / (1.0 + rolled_m / _RELAXATION_M)
    bend = (1.0 - robot.ratio) * along[..., :, None] * along[..., None, :]
    stiffness = (bend + robot.ratio * np.eye(2)) * (robot.load * unwound)[..., None, None]
    legs, wound, body = p.reshape(4, 2, 3), np.zeros((4, 2)), np.zeros((len(u), 3))
    moving = rolled_m.max(axis=1) > 1e-9
    for k in np.flatnonzero(moving):
        pull = np.einsum("wai,wab->iwb", legs, stiffness[k])
        slope = np.einsum("iwb,wbj->ij", pull, legs)
        body[k] = np.linalg.solve(slope, np.einsum("iwb,wb->i", pull, wound + ways[k]))
        wound = unwound[k][:, None] * (wound + ways[k] - legs @ body[k])
    return body


def _record(
    nominal: Nominal,
    name: str,
    motion: str,
    t_s: Array,
    rate: Array,
    heading: Array,
    pose: Array,
    *,
    rng: np.random.Generator,
    corrupted: bool,
) -> Recording:
    angle = np.vstack([np.zeros(4), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * _STEP_S, axis=0)])
    angle += rng.uniform(-np.pi, np.pi, 4)
    register = np.trunc(_lag(rate, _RATE_LAG_S) / _RATE_UNIT_RAD_S) * _RATE_UNIT_RAD_S
    every = slice(0, None, 2)
    wheels = np.column_stack(
        [np.round(angle / _COUNT_RAD) * _COUNT_RAD, np.round(heading / _COUNT_RAD) * _COUNT_RAD, register]
    )[every]
    at_s = np.arange(0.0, t_s[-1], 0.01)
    truth = np.column_stack([np.interp(at_s, t_s, pose[:, k]) for k in range(3)])
    truth += rng.normal(0.0, 1.0, truth.shape) * np.array([1e-5, 1e-5, 4e-5])
    if corrupted:
        truth[len(truth) // 2 :, :2] += (0.04, -0.03)
        truth[100:130] = np.nan
    truth[:, 2] = np.arctan2(np.sin(truth[:, 2]), np.cos(truth[:, 2]))
    receive = t_s[every] + rng.exponential(0.002, len(t_s[every]))
    return build_recording(
        name,
        Log(t_s[every], wheels, receive),
        Log(at_s, truth, at_s + rng.exponential(0.001, len(at_s))),
        motion=motion,
        nominal=nominal,
    )


def make_set(
    robot: HiddenRobot,
    seed: int,
    motions: Iterable[str] = MOTIONS,
    repetitions: int = 4,
    *,
    run_to_run: float = 1.0,
    slip_share: float = 0.25,
    corrupted: str | None = None,
) -> list[Recording]:
    """Simulate recordings `MOTION_k`, several repetitions per motion; a share of them with three slip bursts.

    Args:
        robot: robot with hidden true parameters.
        seed: seed of everything that differs between recordings.
        motions: names of the motions.
        repetitions: number of repetitions per motion.
        run_to_run: scale of the differences from run to run, as for `simulate`.
        slip_share: share of recordings with slip bursts.
        corrupted: name of the one recording that is simulated with faults.
    """
    out = []
    for number, motion in enumerate(motions):
        for k in range(1, repetitions + 1):
            name = f"{motion}_{k}"
            rng = np.random.default_rng([seed, 2, number, k])
            bursts = 3 if rng.random() < slip_share else 0
            out.append(
                simulate(
                    robot,
                    motion,
                    name,
                    rng,
                    run_to_run=run_to_run,
                    slip_bursts=bursts,
                    corrupted=name == corrupted,
                )
            )
    return out
