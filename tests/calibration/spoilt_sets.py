"""Sets of recordings as users make them, by a physics of their own, some of them spoilt in a known way.

Nothing here comes from `hil.calibration.synthetic`, nor from the laws of contact in `hil`. A robot of unknown
wheels drives lines, curves and turns of unlike lengths and speeds. Its wheels creep in proportion to load or
hold by dry friction, lose a part of their way to load and pull, and now and then the body slides by
millimetres.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

CORNERS = 0.1125 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
RADIUS_M = 0.0254
LAWS = ("creep", "dry", "loss", "both")
KINDS = (
    "stuck encoder",
    "stuck steering",
    "mirrored",
    "swapped wheels",
    "degrees",
    "time shift",
    "another body",
    "another drive",
    "frozen truth",
    "leap of truth",
)
_ROW_S, _FINE = 1.0 / 60.0, 2
_COUNT_RAD = 2.0 * np.pi / 4096.0
_STRAIGHT = ("line_x", "line_y", "diagonal")
_TURNING = ("arc", "circle_ccw", "circle_cw", "rotation_ccw", "rotation_cw", "curl")
_COLUMNS = ",".join(
    ["t", *(f"phi{i}" for i in range(1, 5)), *(f"delta{i}" for i in range(1, 5)), "x", "y", "theta"]
)


@dataclass(frozen=True)
class Drive:
    """One recording: t (n,), wheel angles and steering (n, 4), truth (n, 3); SI units, what was spoilt."""

    name: str
    t_s: np.ndarray
    angle: np.ndarray
    steering: np.ndarray
    truth: np.ndarray
    spoilt: str = ""

    def write(self, folder: Path) -> Path:
        """As plain CSV."""
        path = folder / f"{self.name}.csv"
        rows = np.column_stack([self.t_s, self.angle, self.steering, self.truth])
        np.savetxt(path, rows, fmt="%.6f", delimiter=",", header=_COLUMNS, comments="")
        return path


@dataclass(frozen=True)
class _Robot:
    """Wheels (4, 2), m, radii, steering zeros and loads (4,) of a robot, how it slips and how it is driven.

    It is driven with steering zeros that it is believed to have, and a wheel turns by a share too little or
    too much, which its encoder reports.
    """

    wheel_m: np.ndarray
    radius_m: np.ndarray
    zero_rad: np.ndarray
    load: np.ndarray
    law: str
    noise: float
    pull: np.ndarray
    believed_rad: np.ndarray
    tracking: np.ndarray


def make_drives(seed: int, spoilt: tuple[str, ...] = ()) -> list[Drive]:
    """8 to 20 recordings of one robot, as many of them spoilt as kinds are given.

    Args:
        seed: of everything.
        spoilt: of `KINDS`; each in a recording in which it shows.
    """
    rng = np.random.default_rng([seed, 77])
    robot = _robot(rng)
    drives = [_drive(robot, name, shape, rng) for name, shape in _program(rng)]
    free = list(range(len(drives)))
    for kind in spoilt:
        fit = [k for k in free if _shows(kind, drives[k].name)]
        k = int(rng.choice(fit if fit else free))
        free.remove(k)
        others = [d for d in drives if not _alike(d.name, drives[k].name) and not d.spoilt]
        drives[k] = replace(spoil(drives[k], kind, rng, others[int(rng.integers(len(others)))]), spoilt=kind)
    return drives


def drives_without_chance(seed: int) -> tuple[str, list[Drive]]:
    """The law of a seed's robot, and every motion, a metre long, as it drives without noise and bursts."""
    rng = np.random.default_rng([seed, 77])
    robot = _robot(rng)
    still = replace(robot, noise=0.0)
    shapes = {motion: _shape(motion, 1.0, 0.08, 1) for motion in (*_STRAIGHT, *_TURNING)}
    return robot.law, [_drive(still, f"{motion}_1", shape, rng) for motion, shape in shapes.items()]


def _robot(rng: np.random.Generator) -> _Robot:
    zero = np.radians(rng.normal(0.0, 1.0, 4))
    weight = np.array([0.0, rng.choice([0.0, 0.0, -1.0])])
    return _Robot(
        wheel_m=CORNERS * (1.0 + rng.normal(0.0, 0.012, (4, 2))),
        radius_m=RADIUS_M * (1.0 + rng.normal(0.0, 0.012, 4)),
        zero_rad=zero - zero.mean(),
        load=rng.uniform(0.5, 1.5, 4),
        law=str(rng.choice(LAWS)),
        noise=float(rng.uniform(0.5, 2.5)),
        pull=weight,
        believed_rad=rng.choice([0.0, 1.0]) * np.radians(rng.normal(0.0, 1.5, 4)),
        tracking=1.0 + rng.normal(0.0, 0.01, 4),
    )


def _program(rng: np.random.Generator) -> list[tuple[str, tuple[np.ndarray, float]]]:
    """Names and shapes of a set: the twist at full speed (3,) and how long it lasts, s."""
    straight, turning = rng.permutation(_STRAIGHT), rng.permutation(_TURNING)
    motions = [*straight[: rng.integers(2, 4)], *turning[: rng.integers(2, 5)]]
    repetitions = int(rng.integers(2, 4))
    most = int(rng.integers(8, 21))
    length_m, speed_m_s = rng.uniform(0.6, 3.0), rng.uniform(0.04, 0.12)
    out = []
    for motion in motions:
        for k in range(1, repetitions + 1):
            vary = rng.uniform(0.9, 1.1) if rng.random() < 0.8 else rng.uniform(0.5, 1.3)
            out.append((f"{motion}_{k}", _shape(str(motion), length_m * vary, speed_m_s, k)))
    while len(out) < 8:
        motion = motions[len(out) % len(motions)]
        out.append((f"{motion}_{len(out) + 10}", _shape(str(motion), length_m, speed_m_s, 1)))
    return [out[int(k)] for k in np.sort(rng.permutation(len(out))[:most])]


def _shape(motion: str, length_m: float, speed_m_s: float, k: int) -> tuple[np.ndarray, float]:
    v, curve = speed_m_s, speed_m_s / 0.5
    back = -1.0 if k == 3 and motion in _STRAIGHT else 1.0
    twist = {
        "line_x": (back * v, 0.0, 0.0),
        "line_y": (0.0, back * v, 0.0),
        "diagonal": (0.7 * back * v, 0.7 * back * v, 0.0),
        "arc": (0.9 * v, -0.4 * v, 0.8 * curve),
        "circle_ccw": (v, 0.0, curve),
        "circle_cw": (v, 0.0, -curve),
        "rotation_ccw": (0.0, 0.0, v / 0.16),
        "rotation_cw": (0.0, 0.0, -v / 0.16),
        "curl": (-0.5 * v, 0.6 * v, -1.5 * curve),
    }[motion]
    turning = motion.startswith("rotation")
    return np.array(twist), (2.0 * np.pi * 0.16 / v if turning else length_m / v)


def _drive(robot: _Robot, name: str, shape: tuple[np.ndarray, float], rng: np.random.Generator) -> Drive:
    twist, lasts_s = shape
    rest_s, ramp_s, step_s = rng.uniform(0.5, 2.0), rng.uniform(0.3, 1.0), _ROW_S / _FINE
    t_s = np.arange(0.0, lasts_s + 2.0 * rest_s + ramp_s, step_s)
    since = t_s - rest_s
    speed = np.clip(np.minimum(since, lasts_s + ramp_s - since) / ramp_s, 0.0, 1.0)
    steering, rate = _commands(twist)
    angle = np.cumsum(speed[:, None] * rate * robot.tracking * step_s, axis=0)
    sway = np.sin(rng.uniform(0.0, 6.0, 4) + 0.7 * t_s[:, None])
    heading = steering + robot.believed_rad + rng.normal(0.0, 5e-4, 4) + 3e-4 * sway
    body = _slide(robot, _rolled(robot, angle, heading), rng)
    pose = _along(np.r_[rng.normal(0.0, 0.01, 2), rng.normal(0.0, 0.02)], body)
    rows = slice(0, None, _FINE)
    angle, heading = (np.round(a / _COUNT_RAD) * _COUNT_RAD for a in (angle + rng.uniform(-3, 3, 4), heading))
    late_s = rng.normal(0.0, 0.008)
    seen = np.column_stack([np.interp(t_s - late_s, t_s, c) for c in pose.T])
    seen += robot.noise * rng.normal(0.0, (2e-4, 2e-4, 8e-4), seen.shape)
    jitter = rng.uniform(0.0, 2e-3, len(t_s[rows]))
    return Drive(name, t_s[rows] + jitter, angle[rows], heading[rows], seen[rows])


def _commands(twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steering (4,) within +-120 deg and wheel rates (4,) of a twist, by the robot on paper."""
    ways = np.column_stack([twist[0] - CORNERS[:, 1] * twist[2], twist[1] + CORNERS[:, 0] * twist[2]])
    steering, rate = np.arctan2(ways[:, 1], ways[:, 0]), np.hypot(*ways.T) / RADIUS_M
    flip = np.abs(steering) > np.radians(120.0)
    return np.where(flip, steering - np.sign(steering) * np.pi, steering), np.where(flip, -rate, rate)


def _rolled(robot: _Robot, angle: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Ways (n - 1, 4, 2) of the wheels in the body's frame, m."""
    way = np.diff(angle, axis=0) * robot.radius_m
    true = 0.5 * (heading[1:] + heading[:-1]) - robot.zero_rad
    return np.stack([way * np.cos(true), way * np.sin(true)], axis=-1)


def _slide(robot: _Robot, ways: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Body motion (n, 3) of wheels that go these ways: their law, what they lose, what chance adds."""
    x, y = robot.wheel_m.T
    legs = np.zeros((4, 2, 3))
    legs[:, 0, 0] = legs[:, 1, 1] = 1.0
    legs[:, 0, 2], legs[:, 1, 2] = -y, x
    share = np.tile(robot.load, (len(ways), 1))
    body = _balance(legs, ways, share)
    if robot.law in ("dry", "both"):
        for _ in range(8):
            slip = np.linalg.norm(ways - np.einsum("waj,nj->nwa", legs, body), axis=2)
            body = _balance(legs, ways, robot.load / np.maximum(slip, 2e-7))
    if robot.law in ("loss", "both"):
        size = np.linalg.norm(ways, axis=2, keepdims=True)
        lost = 0.02 * ways * (robot.load[:, None] - 1.0) - 0.004 * size * robot.pull
        body = body + _balance(legs, -lost, share) * 0.7
    step_m = np.hypot(body[:, 0], body[:, 1]) + 0.16 * np.abs(body[:, 2])
    draw = robot.noise * rng.normal(0.0, (5e-4, 1e-3, 2e-3))
    turned = np.column_stack([-body[:, 1], body[:, 0], np.zeros(len(body))])
    body = body * (1.0 + draw[0]) + draw[1] * turned
    body[:, 2] += draw[2] * step_m
    body += robot.noise * np.sqrt(step_m)[:, None] * rng.normal(0.0, (6e-4, 6e-4, 2e-3), body.shape)
    if robot.noise and rng.random() < 0.3:
        for _ in range(rng.integers(1, 4)):
            begin = int(rng.uniform(0.1, 0.8) * len(body))
            size = rng.normal(0.0, (5e-3, 5e-3, 1e-2))
            body[begin : begin + 60] += size / 60.0
    return body


def _balance(legs: np.ndarray, ways: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Motion (n, 3) that leaves the least slip, squared and weighted by share (n, 4) of each wheel."""
    left = np.einsum("wai,nw,waj->nij", legs, share, legs)
    return np.linalg.solve(left, np.einsum("wai,nw,nwa->ni", legs, share, ways)[..., None])[..., 0]


def _along(start: np.ndarray, body: np.ndarray) -> np.ndarray:
    theta = start[2] + np.r_[0.0, np.cumsum(body[:, 2])]
    middle = 0.5 * (theta[1:] + theta[:-1])
    c, s = np.cos(middle), np.sin(middle)
    x = start[0] + np.r_[0.0, np.cumsum(c * body[:, 0] - s * body[:, 1])]
    y = start[1] + np.r_[0.0, np.cumsum(s * body[:, 0] + c * body[:, 1])]
    return np.column_stack([x, y, theta])


def _alike(one: str, other: str) -> bool:
    return one.rsplit("_", 1)[0] == other.rsplit("_", 1)[0]


def _shows(kind: str, name: str) -> bool:
    """Whether this kind of damage changes a drive of this motion: wheels of a line are all alike."""
    turns = name.startswith(_TURNING)
    if kind in ("swapped wheels", "another body"):
        return turns
    if kind == "mirrored":
        return turns or name.startswith("diagonal")
    return True


def spoil(drive: Drive, kind: str, rng: np.random.Generator, other: Drive) -> Drive:
    """A drive, spoilt in one of `KINDS`: one wheel is one that rolls; `other` is of another motion."""
    rows, t_s = len(drive.t_s), drive.t_s
    way = np.abs(np.diff(drive.angle, axis=0)).sum(axis=0)
    begin, wheel = int(rng.uniform(0.1, 0.6) * rows), int(rng.choice(np.flatnonzero(way >= np.median(way))))
    angle, steering, truth = drive.angle.copy(), drive.steering.copy(), drive.truth.copy()
    if kind == "stuck encoder":
        angle[begin:, wheel] = angle[begin, wheel]
    elif kind == "stuck steering":
        steering[:, wheel] += rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0)
    elif kind == "mirrored":
        truth *= (1.0, -1.0, -1.0)
    elif kind == "swapped wheels":
        order = np.arange(4)
        one, two = rng.permutation(4)[:2]
        order[[one, two]] = two, one
        angle, steering = angle[:, order], steering[:, order]
    elif kind == "degrees":
        which = rng.integers(3) if np.ptp(truth[:, 2]) > 1.0 else 0
        angle, truth = (np.degrees(angle), truth) if which == 0 else (angle, truth)
        steering = np.degrees(steering) if which == 1 else steering
        truth = truth * (1.0, 1.0, np.degrees(1.0)) if which == 2 else truth
    elif kind == "time shift":
        late_s = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.5)
        truth = np.column_stack([np.interp(t_s - late_s, t_s, c) for c in truth.T])
    elif kind == "another body":
        c, s = np.cos(truth[:, 2]), np.sin(truth[:, 2])
        ahead, left = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.08, 0.3, 2)
        truth[:, 0] += c * ahead - s * left
        truth[:, 1] += s * ahead + c * left
        truth[:, 2] += rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.0)
    elif kind == "another drive":
        at = np.linspace(0.0, 1.0, rows) * (t_s[-1] - t_s[0])
        truth = np.column_stack([np.interp(at, other.t_s - other.t_s[0], c) for c in other.truth.T])
    elif kind == "frozen truth":
        truth[begin:] = truth[begin]
    elif kind == "leap of truth":
        truth[begin:, :2] += rng.choice([-1.0, 1.0], 2) * rng.uniform(0.04, 0.3, 2)
    else:
        raise ValueError(kind)
    return replace(drive, angle=angle, steering=steering, truth=truth)
