"""Features of short windows at constant speed, in groups: what a signal looks like, not where it goes."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from hil.core.geometry import Array
from hil.datasets.wheel_log import Recording

GROUPS = ("drive rates", "wheel angles", "steering", "truth steps", "heading")

WINDOW_S = 4.0
_STEP_S = 2.0
_TURNS_RAD_S, _EVEN_RAD_S = 0.1, 0.25
_PIECE = 24
_LEAST = 1e-9
_BANDS_HZ = (0.2, 1.0, 3.0, 10.0)


def windows(recording: Recording) -> Iterator[dict[str, Array]]:
    """Features of every window of a recording in which all drives turn evenly, by group.

    A feature is the logarithm of a size, or a correlation of neighbouring values.

    Args:
        recording: run with velocity register and ground truth.
    """
    t_s, rates = recording.t_s, recording.wheel_rate_rad_s
    for begin_s in np.arange(t_s[0], t_s[-1] - WINDOW_S, _STEP_S):
        of, seen = (
            slice(*np.searchsorted(times_s, (begin_s, begin_s + WINDOW_S)).tolist())
            for times_s in (t_s, recording.truth_t_s)
        )
        if of.stop - of.start < 3 * _PIECE or seen.stop - seen.start < 3 * _PIECE:
            continue
        even = np.max(np.ptp(rates[of], axis=0)) < _EVEN_RAD_S
        if even and np.min(np.abs(rates[of])) > _TURNS_RAD_S:
            yield _features(recording, of, seen)


def _features(recording: Recording, of: slice, seen: slice) -> dict[str, Array]:
    t_s, truth_t_s = recording.t_s[of], recording.truth_t_s[seen]
    rates, angles, steering = (
        _about(t_s, values[of], 1)
        for values in (recording.wheel_rate_rad_s, recording.wheel_angle_rad, recording.steering_rad)
    )
    changes = np.mean(np.abs(np.diff(recording.steering_rad[of], axis=0)) > _LEAST) / np.mean(np.diff(t_s))
    rough = [
        _about(truth_t_s[seen_at], recording.truth_pose[seen][seen_at], 3)
        for seen_at in (slice(k, k + _PIECE) for k in range(0, len(truth_t_s) - _PIECE, _PIECE))
    ]
    places, heading = np.concatenate(rough)[:, :2], np.concatenate(rough)[:, 2:]
    between_s = np.array([np.median(np.diff(truth_t_s))])
    groups = {
        "drive rates": (_size(rates), _size(np.diff(rates, axis=0)), _alike(rates, 1), _alike(rates, 5)),
        "wheel angles": (_size(angles), *_bands(t_s, angles)),
        "steering": (_size(steering), np.log(_LEAST + changes), _alike(steering, 1), _alike(steering, 5)),
        "truth steps": (_size(places), _alike(places, 1), _alike(places, 3), np.log(between_s[0])),
        "heading": (_size(heading), _alike(heading, 1), _alike(heading, 3)),
    }
    return {name: np.array(groups[name], dtype=np.float64) for name in GROUPS}


def _about(t_s: Array, values: Array, degree: int) -> Array:
    """Values (n, k) about their polynomials of a degree in time."""
    table = np.vander((t_s - t_s[0]) / max(float(np.ptp(t_s)), _LEAST), degree + 1)
    out: Array = values - table @ np.linalg.lstsq(table, values, rcond=None)[0]
    return out


def _size(values: Array) -> float:
    """Logarithm of the mean standard deviation of columns."""
    return float(np.log(_LEAST + np.mean(np.std(values, axis=0))))


def _alike(values: Array, lag: int) -> float:
    """Correlation of values (n, k) with those `lag` rows later, over all columns."""
    return float(np.sum(values[lag:] * values[:-lag]) / (_LEAST**2 + np.sum(values**2)))


def _bands(t_s: Array, values: Array) -> list[float]:
    """Logarithms of the power of values (n, k) in bands of frequency, the rows taken as evenly spaced."""
    power = np.mean(np.abs(np.fft.rfft(values, axis=0)) ** 2, axis=1) / len(values) ** 2
    at_hz = np.fft.rfftfreq(len(values), float(np.mean(np.diff(t_s))))
    bands = pairwise(_BANDS_HZ)
    return [float(np.log(_LEAST**2 + np.sum(power[(at_hz >= low) & (at_hz < high)]))) for low, high in bands]
