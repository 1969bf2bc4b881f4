"""Composes the sentences under `warnings` of a calibration's result."""

from collections.abc import Mapping, Sequence

import numpy as np

from hil.calibration.cross_validation import Deployed, Table
from hil.calibration.excitation import DIRECTIONS, Driven, driven, undriven
from hil.calibration.fitting import Fit
from hil.calibration.identifiability import Identifiability, identifiability
from hil.calibration.motion_models import make_model
from hil.datasets.fit_blocks import Blocks
from hil.datasets.nominal_robot import lever_m
from hil.datasets.recording_names import MOTIONS
from hil.datasets.sampling import LONGEST_GAP_S
from hil.datasets.start_pose import start_of
from hil.datasets.truth_correction import notes_of
from hil.datasets.truth_of_wheels import of_wheels
from hil.datasets.wheel_log import Recording, classify
from hil.datasets.wrong_signs import CHECK_COLUMNS, contradictions
from hil.robot.kinematics import WheelGeometry
from hil.robot.odometry import integrate

RECORD = {
    "forward": "line_x (straight ahead, 2 m or more)",
    "sideways": "line_y (straight to the side, 2 m or more)",
    "turning": "rotation_ccw and rotation_cw (turns on the spot)",
}
_CLEARLY_M, _CLEARLY_RAD = 2e-3, float(np.radians(0.5))
_MUCH = 1.5
_LENGTHS = 12
_UNEXPLAINED = 0.2
HARDLY = 0.05
_NO_WORKSHOP = (
    " (ten standard deviations of the prior, more than a workshop leaves; look for a wrong column, unit or "
    "bench file)"
)
_POSITION, _HEADING = "rmse_position_m", "rmse_theta_rad"


def caveats(
    recordings: Sequence[Recording],
    found: Fit,
    spectrum: Identifiability,
    paper: Fit | None,
    tables: Mapping[str, Table],
    deployed: Deployed,
) -> tuple[str, ...]:
    """All warnings: first repairs, then weaknesses of the result, then how to read it.

    Args:
        recordings: recordings that were fitted.
        found: the fit.
        spectrum: identifiability of the fit.
        paper: fit with the paper's setting on the same data, where possible.
        tables: validation by name, empty without a validation.
        deployed: errors of the result on the recordings.
    """
    out = warnings_of(recordings)
    out += contradictions(recordings, found.problem.tyres.with_vector(found.problem.nominal))
    if len(recordings) == 1:
        out.append("one recording only: no interval, no cross-validation; repeat the motion")
    elif tables and "leave_one_repetition_out" not in tables:
        out.append(
            "no motion is repeated, so no repetition can be left out: how well the result predicts another "
            "drive of these motions is not known; record each at least twice"
        )
    out += motions_apart(found)
    out += unexplained(found)
    if spectrum.at_bound:
        far = "" if found.problem.setting.bounds is not None else _NO_WORKSHOP
        out.append("at their bound, so the bound decides them: " + ", ".join(spectrum.at_bound) + far)
    if not found.solution.converged:
        out.append(
            "the fit ended before its parameters had settled within a twentieth of a standard error; "
            "compare it with another --method"
        )
    if spectrum.unobservable:
        out.append("unobservable, moved by their prior only: " + ", ".join(spectrum.unobservable))
    out += extrapolating(found)
    out += unpredicted(tables)
    out += worse_as_twist(deployed, found.problem.setting.model)
    total = len(found.solution.z)
    out.append(
        f"the data determine {spectrum.determined} directions of the {total} parameters, "
        f"{spectrum.determined_without_contact_law} without a law of contact: the others depend on the model "
        f"{found.problem.setting.model}; single parameters are effective values, only their "
        "combinations are measured"
    )
    if paper is not None:
        out.append(
            f"under the paper's setting the data determine {identifiability(paper).determined} of its "
            f"{len(paper.solution.z)} parameters; the bounds decide the rest"
        )
    return tuple(out)


def left_out_because(rejected: Mapping[str, str]) -> list[str]:
    """One line for each recording that was left out, with name and reason."""
    return [f"{name}: left out: {why}" for name, why in rejected.items()]


def motions_apart(found: Fit) -> list[str]:
    """One line for each motion with at least two recordings of which every one fits badly."""
    weights: dict[str, list[float]] = {}
    for motion, weight in zip(found.problem.blocks.motions, found.problem.weights, strict=True):
        weights.setdefault(motion, []).append(float(weight))
    return [
        f"{motion}: none of its recordings fits those of other motions, so they hardly count; {CHECK_COLUMNS}"
        for motion, own in weights.items()
        if len(own) > 1 and max(own) < HARDLY
    ]


def warnings_of(recordings: Sequence[Recording]) -> list[str]:
    """Warnings of the recordings themselves: damage, repairs, a start in motion, corrections."""
    lines = [line for r in recordings for line in (*r.warnings(), *start_of(r).doubt(r.name))]
    lines += [f"{r.name}: {why}" for r in recordings if (why := of_wheels(r))] + misnamed(recordings)
    return [*lines, *unused_in(recordings), *_taken_out(recordings), *notes_of(recordings)]


def misnamed(recordings: Sequence[Recording]) -> list[str]:
    """One line for recordings whose path is another of the six motions than their name says; else none."""
    found = []
    for one in recordings:
        path = (
            classify(one.wheel_angle_rad, one.truth_pose, one.nominal.radius_m) if one.has_truth else "other"
        )
        if one.motion in MOTIONS and path in MOTIONS and path != one.motion and not one.contradictions:
            found.append(f"{one.name} is a {path} by its path")
    if not found:
        return []
    return [
        f"names and paths differ: {', '.join(found)}; tables by motion, and folds that leave a motion out, "
        "go by the names: rename the files"
    ]


def unused_in(recordings: Sequence[Recording]) -> list[str]:
    """One line for each set of topics that bags hold and `--topics` does not name."""
    found: dict[tuple[str, ...], list[str]] = {}
    for one in recordings:
        if one.unused:
            found.setdefault(one.unused, []).append(one.name)
    return [
        f"{names[0]}: not used, because --topics does not name them: {', '.join(topics)}"
        + (f" ({len(names) - 1} more recordings likewise)" if len(names) > 1 else "")
        for topics, names in found.items()
    ]


def _taken_out(recordings: Sequence[Recording]) -> list[str]:
    """One line if coupling of the steering into the drive encoders was taken out; else none."""
    known = next((one.coupling for one in recordings if one.coupling), ())
    shown = ", ".join(f"{turns:.4f}" for turns in known)
    return [f"taken out of phi1 to phi4, as coupling of the steering: {shown} of delta"] if known else []


def crossed_gaps(recordings: Sequence[Recording]) -> list[str]:
    """One line if the paper's preprocessing steps across gaps of the ground truth; else none."""
    lost = [r.name for r in recordings if np.max(np.diff(r.truth_receive_s)) > LONGEST_GAP_S]
    if not lost:
        return []
    return [
        "the paper's preprocessing (--model paper) crosses gaps of the ground truth in one step: its errors "
        f"on {', '.join(lost)} are not those of the wheels alone"
    ]


def unexplained(found: Fit) -> list[str]:
    """One line if more than a fifth of the way is left as error in the typical recording; else none."""
    blocks, weight = found.problem.blocks, np.array([1.0, 1.0, lever_m(found.geometry)])
    inside = blocks.mask[..., None] * weight
    left = np.linalg.norm(found.problem.errors(found.solution.z) * inside, axis=2)
    way = np.linalg.norm((blocks.truth - blocks.start[:, None]) * inside, axis=2).max(axis=1)
    rms = np.sqrt((left**2).sum(axis=1) / np.maximum(blocks.compared, 1))
    share = float(np.median(rms / np.maximum(way, 1e-9)))
    if share < _UNEXPLAINED:
        return []
    return [
        f"the result does not explain the recordings: {100 * share:.0f} % of the way is left as error in "
        f"the typical one; do not use it, {CHECK_COLUMNS}"
    ]


def common_zero_rad(found: Fit) -> float | None:
    """Mean deviation of the steering zeros from nominal, rad; None where they were not fitted."""
    zeros = found.solution.z[_LENGTHS:]
    return float(np.mean(zeros - found.problem.nominal[_LENGTHS:])) if len(zeros) else None


def extrapolating(found: Fit) -> list[str]:
    """One line for each direction that no recording drives on its own: the effect, and what to record."""
    nominal = found.problem.tyres.with_vector(found.problem.nominal)
    return [
        f"no recording drives {name} on its own, so there the calibration extrapolates, as parameters and "
        f"with --deploy twist (a metre {name} ends {_parting(found, nominal, name)} from where nominal "
        f"odometry ends); record {RECORD[name]} at least twice"
        for name in driven(found.problem.blocks, nominal).missing
    ]


def beyond_driven(blocks: Blocks, nominal: WheelGeometry, known: Driven) -> list[str]:
    """One line for each motion of other recordings in a direction that the calibration's did not drive.

    Args:
        blocks: blocks of the other recordings.
        nominal: geometry for the odometry of their motion.
        known: distances driven in the calibration's recordings.
    """
    return [
        f"{motion} drives {' and '.join(names)}, which no recording of the calibration did: it extrapolates; "
        f"calibrate again with {' and '.join(RECORD[n] for n in names)}"
        for motion, names in undriven(blocks, nominal, known).items()
    ]


def _parting(found: Fit, nominal: WheelGeometry, name: str) -> str:
    """Distance between fitted and nominal odometry after a metre in one direction (at the wheels)."""
    steps, twist = 100, np.zeros(3)
    twist[DIRECTIONS.index(name)] = 1.0 / steps / (lever_m(nominal) if name == "turning" else 1.0)
    wheel_rad = np.tile(nominal.projection() @ twist / np.repeat(nominal.radius_m, 2), (steps, 1))
    fitted = make_model(found.problem.setting.model, wheel_rad, nominal).motion(found.solution.z)
    here, there = (integrate(np.zeros(3), m)[-1] for m in (fitted, np.tile(twist, (steps, 1))))
    gap = here - there
    return f"{1e3 * np.hypot(gap[0], gap[1]):.0f} mm and {abs(np.degrees(gap[2])):.1f} deg"


def unpredicted(tables: Mapping[str, Table]) -> list[str]:
    """One line for each motion that a fit to the others predicts worse than nominal parameters do."""
    left_out, nominal = tables.get("leave_one_motion_out", {}), tables.get("nominal", {})
    out = []
    for motion, row in left_out.items():
        before = nominal[motion]
        lost_m, lost_rad = row[_POSITION] - before[_POSITION], row[_HEADING] - before[_HEADING]
        if motion != "mean" and (lost_m > _CLEARLY_M or lost_rad > _CLEARLY_RAD):
            out.append(
                f"a fit without {motion} predicts it worse than nominal parameters do ({_errors(row)} "
                f"against {_errors(before)}): motions that are not among the recordings may be predicted as "
                f"badly; keep {motion} among them and record every motion that the robot is going to drive"
            )
    return out


def worse_as_twist(deployed: Deployed, model: str) -> list[str]:
    """One line if `--deploy twist` is clearly worse than the parameters on some motions; else none."""
    lost = []
    for motion, row in deployed.parameters.items():
        other = deployed.twist[motion]
        far = other[_POSITION] - row[_POSITION] > _CLEARLY_M and other[_POSITION] > _MUCH * row[_POSITION]
        if motion != "mean" and far:
            lost.append(f"{motion} ({_errors(other)} against {_errors(row)})")
    if not lost:
        return []
    return [
        f"with --deploy twist errors grow on {', '.join(lost)}: one 3x3 matrix cannot replace the model "
        f"{model} there; deploy the parameters"
    ]


def _errors(row: Mapping[str, float]) -> str:
    return f"{1e3 * row[_POSITION]:.1f} mm, {np.degrees(row[_HEADING]):.2f} deg"
