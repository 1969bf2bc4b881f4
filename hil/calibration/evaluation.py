"""Compares odometry with ground truth: the error table of recordings (`hil evaluate`).

Two kinds of preprocessing. `paper` is the authors' own (arXiv 2509.04016): receive stamps made increasing,
servo signals interpolated to the ground-truth stamps, the first 29 samples dropped, forward Euler, initial
heading from one sample. The default integrates on SE(2) from wheel row to wheel row, also in gaps of the
ground truth, and compares only at rows of the ground truth. It starts at the pose of
`hil.datasets.start_pose`.

Errors e_m and e_a are the paper's (arXiv 2509.04016): e_m is the largest absolute error of any repetition,
e_a the mean over the repetitions of each one's largest absolute error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.sampling import block_vectors, interpolate, truth_window, wheel_edges, wheel_steps
from hil.datasets.start_pose import start_of
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry, twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate, sample_path

FRICTION_BLOCK_S = 0.3
_PAPER_DROPPED = 29


@dataclass(frozen=True)
class Track:
    """Odometry and ground truth of one recording at the same instants.

    Attributes:
        t_s: instants (n,), from 0.
        odometry, truth: poses (n, 3), m, m, rad.
    """

    recording: Recording
    t_s: Array
    odometry: Array
    truth: Array

    @property
    def error(self) -> Array:
        """Odometry minus truth, (n, 3)."""
        return self.odometry - self.truth


@dataclass(frozen=True)
class Steps:
    """Data for the odometry of a recording that do not depend on the wheel parameters.

    Attributes:
        t_s: (n,) instants of the ground truth.
        truth: (n, 3) poses at these instants.
        edges_s: (k + 1,) edges of the steps, s.
        wheel_rad: (k, 8) wheel vectors of each step, rad.
        start: (3,) pose at the first edge.
        by_the_paper: True to integrate by forward Euler.
    """

    t_s: Array
    truth: Array
    edges_s: Array
    wheel_rad: Array
    start: Array
    by_the_paper: bool = False


def track(
    recording: Recording,
    geometry: WheelGeometry,
    model: str = "exact",
    signal: str = "position",
    correction: Array | None = None,
) -> Track:
    """Odometry of a recording at its ground-truth stamps.

    Args:
        recording: the run.
        geometry: wheel parameters.
        model: forward model; `paper` also uses the authors' preprocessing.
        signal: `position` or `velocity` (the lagging, truncated register).
        correction: 3x3 matrix that multiplies each body displacement, from a twist calibration.
    """
    return track_all([recording], geometry, model, signal, correction)[0]


def track_all(
    recordings: Sequence[Recording],
    geometry: WheelGeometry,
    model: str = "exact",
    signal: str = "position",
    correction: Array | None = None,
) -> list[Track]:
    """`track` for several recordings, with one evaluation of the forward model; `correction` (3, 3)."""
    paper = model == "paper" and correction is None
    kind = "paper" if paper else "blocks" if model == "dry-friction" else "rows"
    every = [_steps(r, kind, signal) for r in recordings]
    if not every:
        return []
    u = rolled(geometry.vector(), np.concatenate([s.wheel_rad for s in every]))
    motion = twist_of_vectors(geometry, u, model)
    if correction is not None:
        motion = motion @ correction.T
    parts = np.split(motion, np.cumsum([len(s.wheel_rad) for s in every])[:-1])
    return [_along(r, s, part) for r, s, part in zip(recordings, every, parts, strict=True)]


def _along(recording: Recording, steps: Steps, motion: Array) -> Track:
    """Integrate body displacements (k, 3) of the steps to a track."""
    poses = integrate(steps.start, motion, "euler" if steps.by_the_paper else "exponential")
    if not steps.by_the_paper:
        poses = sample_path(steps.t_s, steps.edges_s, poses, motion)
    return Track(recording, steps.t_s - steps.t_s[0], poses, steps.truth)


def _steps(recording: Recording, kind: str, signal: str) -> Steps:
    """Steps between wheel rows (`rows`), in 0.3 s blocks (`blocks`), or as the paper's (`paper`); cached."""
    known = recording.derived.get((kind, signal))
    if known is None:
        if kind == "paper":
            known = _paper_steps(recording, signal)
        else:
            at_s, truth = truth_window(recording)
            if kind == "rows":
                edges_s = wheel_edges(recording, at_s[0], at_s[-1])
                wheel_rad = wheel_vectors(*wheel_steps(recording, edges_s, signal))
            else:
                edges_s = block_edges(at_s, FRICTION_BLOCK_S)
                wheel_rad = block_vectors(recording, edges_s, signal)
            known = Steps(at_s, truth, edges_s, wheel_rad, start_of(recording).pose)
        recording.derived[kind, signal] = known
    return known


def block_edges(at_s: Array, block_s: float) -> Array:
    """Edges (b + 1,), s, of blocks of `block_s` from the first instant to just past the last."""
    count = int(np.ceil((at_s[-1] - at_s[0]) / block_s))
    return np.asarray(at_s[0] + np.arange(count + 1) * block_s, dtype=np.float64)


def rolled(z: Array, wheel_rad: Array) -> Array:
    """Wheel displacement vectors (n, 8), m, from raw wheel vectors (n, 8), rad, and parameters z."""
    out = np.empty_like(wheel_rad)
    roll(turned_wheels(z), wheel_rad.T, out.T)
    return out


def turned_wheels(z: Array) -> Array:
    """Components r cos d and r sin d of each wheel, (2, 4), of parameters z; input of `roll`."""
    zero = z[12:16] if len(z) == 16 else np.zeros(4)
    return np.stack([z[8:12] * np.cos(zero), z[8:12] * np.sin(zero)])


def roll(turned: Array, q: Array, u: Array) -> None:
    """Fill u with displacement vectors, m, from raw wheel vectors q, rad; (8,), or (8, n) for n steps."""
    for i in range(4):
        c, s, qx, qy = turned[0, i], turned[1, i], q[2 * i], q[2 * i + 1]
        u[2 * i], u[2 * i + 1] = c * qx + s * qy, c * qy - s * qx


def _paper_steps(recording: Recording, signal: str) -> Steps:
    at_s = recording.truth_receive_s[_PAPER_DROPPED:]
    if len(at_s) < 2:
        raise DataError(
            recording.name,
            f"has {len(recording.truth_receive_s)} rows of ground truth",
            expected=f"more than {_PAPER_DROPPED + 1}: the paper leaves out the first {_PAPER_DROPPED}",
        )
    truth = recording.truth_pose[_PAPER_DROPPED:]
    steering = interpolate(at_s, recording.receive_s, recording.steering_rad)[:-1]
    if signal == "velocity":
        if not recording.has_rates:
            wheel_steps(recording, at_s, signal)
        rate = interpolate(at_s, recording.receive_s, recording.wheel_rate_rad_s)[:-1]
        rotation = rate * np.diff(at_s)[:, None]
    else:
        rotation = np.diff(interpolate(at_s, recording.receive_s, recording.wheel_angle_rad), axis=0)
    return Steps(at_s, truth, at_s, wheel_vectors(rotation, steering), truth[0], by_the_paper=True)


def metrics(tracks: Sequence[Track]) -> dict[str, float]:
    """Errors over the repetitions of one motion; keys may be added, never renamed."""
    worst = np.array([np.max(np.abs(t.error), axis=0) for t in tracks])
    out: dict[str, float] = {"n": len(tracks)}
    for k, axis in enumerate(("x", "y", "theta")):
        out[f"e_{axis}_m"] = float(worst[:, k].max())
        out[f"e_{axis}_a"] = float(worst[:, k].mean())
    out["rmse_position_m"] = float(np.mean([position_rmse(t) for t in tracks]))
    out["rmse_theta_rad"] = float(np.mean([np.sqrt(np.mean(t.error[:, 2] ** 2)) for t in tracks]))
    out["final_position_m"] = float(np.mean([np.hypot(*t.error[-1, :2]) for t in tracks]))
    return out


def position_rmse(run: Track) -> float:
    """Root mean square over time of the distance between odometry and truth, m."""
    return float(np.sqrt(np.mean(np.sum(run.error[:, :2] ** 2, axis=1))))


def cost(tracks: Sequence[Track]) -> float:
    """The paper's J: squared errors summed over recordings, samples and x, y, theta (m^2 + rad^2)."""
    return float(sum(np.sum(t.error**2) for t in tracks))


def evaluate(tracks: Sequence[Track]) -> dict[str, object]:
    """Error table of recordings, by motion, with the mean over motions."""
    groups: dict[str, list[Track]] = {}
    for run in tracks:
        groups.setdefault(run.recording.motion, []).append(run)
    motions: Mapping[str, dict[str, float]] = {name: metrics(runs) for name, runs in groups.items()}
    keys = ("rmse_position_m", "rmse_theta_rad", "final_position_m")
    return {
        "recordings": len(tracks),
        "cost": cost(tracks),
        "motions": motions,
        "mean": {k: float(np.mean([m[k] for m in motions.values()])) for k in keys},
    }
