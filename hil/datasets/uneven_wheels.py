"""Finds a single wheel that goes otherwise in some recordings than in others, by what the four wheels roll.

The ways of four wheels are those of one rigid body, but for radii, steering zeros and places, which are the
same in all recordings. Slip of the body, its contact and the ground truth do not matter: what a rigid body
explains is taken out of each stretch. A wheel that alone explains what is left lost counts, has play, was set
anew or was misread.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.repetition_groups import against, by_motion, chosen, grouped
from hil.datasets.wheel_displacements import Complexes
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_DIFFERS = 0.01
"""Difference of two recordings (rad, share of the way): 0.004 at most of the real ones."""
_LEFT, _OTHERS = 0.1, 3.0
"""Share of the squares that the wheel may leave, and by how much more any other one has to leave."""
_FEWEST, _MOTIONS, _FAR = 4, 2, 0.3
"""Recordings that are needed, and motions whose repetitions differ.
From `_FAR` on (rad, share) other checks name what it is."""
_NOISE, _TOLERANCE, _KNOWN = 0.001, 0.03, 0.02
"""Noise and tolerances (share of the way, rad, share of a lever); singular values beside the largest."""
_CORRECTIONS, _REFINED = 3, 30
_OTHERWISE = "by the ways of the other three wheels its {} wheel goes otherwise than in "
_AGREE, _OPEN = (
    "{} other recordings, which agree",
    "others, and no group is the larger one ({}): which is right is not known",
)
_CAUSES = "; it lost counts, has play, was set anew or was misread"


@dataclass(frozen=True)
class _Block:
    """What the stretches of a recording say, as `columns` (k, 16) @ parameters = `lacks` (k,).

    Parameters of each wheel: share of its way, steering zero, rad, and place, as shares of its lever.
    """

    columns: Array
    lacks: Array


def with_uneven_wheels(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name a wheel that goes otherwise than in the larger group of them.

    Args:
        recordings: recordings of one robot.
    """
    found = {k: own for k, one in enumerate(recordings) if (own := Stretches.of(one)) is not None}
    far = [own.off is not None and bool(np.abs(own.off).max() > _FAR) for own in found.values()]
    if len(found) < _FEWEST or any(far):
        return list(recordings)
    named = _uneven([own.rolled for own in found.values()], _places(recordings[0]))
    if named is None:
        return list(recordings)
    wheel, usual, refined = named
    off = dict(zip(found, usual, strict=True))
    # geometry does the same to all repetitions of a motion
    motions: dict[str, list[list[int]]] = by_motion(recordings, off, _differ(off))
    if sum(len(groups) > 1 for groups in motions.values()) < _MOTIONS:
        off = dict(zip(found, refined, strict=True))
        motions = {"": grouped(list(found), _differ(off))}
    choice = chosen(motions, lambda _: None)
    names, out = [one.name for one in recordings], list(recordings)
    for k in sorted({*choice.kept, *choice.open}):
        others = choice.kept.get(k, ())
        which = _AGREE.format(len(others))
        if k in choice.open:
            others = [i for group in choice.open[k] if k not in group for i in group]
            which = _OPEN.format(against(choice.open[k], names))
        by = off[k] - complex(np.mean([off[i] for i in others]))
        said = _OTHERWISE.format(WHEELS[wheel]) + which + _of_wheel(by, wheel)
        out[k] = out[k].contradicted(said)
    return out


def _differ(off: Mapping[int, complex]) -> Callable[[int, int], bool]:
    return lambda a, b: _size(off[a] - off[b]) > _DIFFERS


def _of_wheel(by: complex, wheel: int) -> str:
    factor = f"phi{wheel + 1} grows {1.0 + by.real:.3f} times as much"
    turn = f"delta{wheel + 1} is {by.imag:+.3f} rad further"
    said = [words for words, size in ((factor, by.real), (turn, by.imag)) if abs(size) > 0.3 * _size(by)]
    return f": {' and '.join(said)}{_CAUSES}"


def _size(off: complex) -> float:
    return max(abs(off.real), abs(off.imag))


def _places(one: Recording) -> Complexes:
    wheels = one.nominal.geometry
    return np.asarray(wheels.x_m + 1j * wheels.y_m)


def _uneven(rolled: Sequence[Complexes], place_m: Complexes) -> tuple[int, Complexes, Complexes] | None:
    """A wheel, and by how much it goes further (share) and to the left (rad) in each recording; None if none.

    First with the smallest such values (n,), then with the fewest (n,): only differences within a motion are
    sure, as between motions places may explain a part.

    Args:
        rolled: ways (s, 4) of the wheels in the stretches of each recording, m.
        place_m: (4,) nominal places.
    """
    blocks = _of_one_robot(rolled, place_m)
    usual = _left(blocks, _fitted(blocks))
    fits = [_fitted(blocks, wheel) for wheel in range(len(WHEELS))]
    left = [_left(blocks, fit, wheel) for wheel, fit in enumerate(fits)]
    wheel = int(np.argmin(left))
    others = min(own for k, own in enumerate(left) if k != wheel)
    least = len(blocks) * _NOISE**2
    if usual < least or left[wheel] > _LEFT * usual or others < _OTHERS * left[wheel]:
        return None
    own = fits[wheel]
    for _ in range(_REFINED):
        each = np.maximum(np.abs(_each(own)), _NOISE)
        own = _fitted(blocks, wheel, each)
    return wheel, _each(fits[wheel]), _each(own)


def _of_one_robot(rolled: Sequence[Complexes], place_m: Complexes) -> list[_Block]:
    """Equations of all recordings about the radii, zeros and places that fit them best."""
    factor, place, lever_m = np.ones(len(WHEELS), dtype=np.complex128), place_m, float(np.abs(place_m).mean())
    blocks = [_block(own, place, lever_m) for own in rolled]
    for _ in range(_CORRECTIONS):
        x = _fitted(blocks).reshape(len(WHEELS), 4)
        factor, place = factor * (1.0 + x[:, 0] + 1j * x[:, 1]), place + lever_m * (x[:, 2] + 1j * x[:, 3])
        blocks = [_block(own / factor, place, lever_m) for own in rolled]
    return blocks


def _block(rolled: Complexes, place_m: Complexes, lever_m: float) -> _Block:
    """Equations of stretches (s, 4) for changes of parameters about these places, by share of the way."""
    ones = np.ones_like(place_m)
    rigid = np.column_stack([_parts(ones), _parts(1j * ones), _parts(1j * place_m)])
    twist = _parts(rolled) @ np.linalg.pinv(rigid).T
    rest = np.eye(len(rigid)) - rigid @ np.linalg.pinv(rigid)
    turn = twist[:, 2:]
    ways = twist[:, :1] + 1j * twist[:, 1:2] + 1j * turn * place_m
    columns = np.zeros((len(rolled), len(rigid), 4 * len(WHEELS)))
    for i in range(len(WHEELS)):
        own = (ways[:, i], 1j * ways[:, i], 1j * lever_m * turn[:, 0], -lever_m * turn[:, 0])
        for j, column in enumerate(own):
            alone = np.zeros_like(rolled)
            alone[:, i] = column
            columns[:, :, 4 * i + j] = _parts(alone) @ rest.T
    size = float(np.sqrt(np.sum(np.mean(np.abs(rolled) ** 2, axis=1))))
    flat, lacks = columns.reshape(-1, 4 * len(WHEELS)) / size, (_parts(rolled) @ rest.T).ravel() / size
    squares, v = np.linalg.eigh(flat.T @ flat)
    sizes = np.sqrt(np.maximum(squares, 0.0))
    known = sizes > _KNOWN * sizes[-1]
    v, sizes = v[:, known], sizes[known]
    return _Block(sizes[:, None] * v.T, v.T @ (flat.T @ lacks) / sizes)


def _parts(ways: Complexes) -> Array:
    """Real and imaginary parts (..., 2 n) of ways (..., n)."""
    return np.concatenate([ways.real, ways.imag], axis=-1)


def _matrix(blocks: Sequence[_Block], wheel: int | None) -> Array:
    """Columns of the parameters, and of share and angle of one wheel in each recording."""
    common = np.concatenate([own.columns for own in blocks])
    if wheel is None:
        return common
    each, row = np.zeros((len(common), 2 * len(blocks))), 0
    for k, own in enumerate(blocks):
        end = row + len(own.columns)
        each[row:end, 2 * k : 2 * k + 2] = own.columns[:, 4 * wheel : 4 * wheel + 2]
        row = end
    return np.concatenate([common, each], axis=1)


def _fitted(blocks: Sequence[_Block], wheel: int | None = None, each: Array | None = None) -> Array:
    """Parameters (16,), then share and angle of the wheel in each recording, with tolerances as a prior."""
    matrix, lacks = _matrix(blocks, wheel), np.concatenate([own.lacks for own in blocks])
    width = np.full(matrix.shape[1], _TOLERANCE)
    if each is not None:
        width[4 * len(WHEELS) :] = np.repeat(each, 2)
    rows = np.concatenate([matrix, np.diag(_NOISE / width)])
    x = np.linalg.lstsq(rows, np.append(lacks, np.zeros(len(width))), rcond=None)[0]
    return np.asarray(x)


def _left(blocks: Sequence[_Block], x: Array, wheel: int | None = None) -> float:
    """Sum of squares that parameters leave."""
    lacks = np.concatenate([own.lacks for own in blocks])
    return float(np.sum((lacks - _matrix(blocks, wheel) @ x) ** 2))


def _each(x: Array) -> Complexes:
    """Share and angle (n,) of the wheel in each recording."""
    own = x[4 * len(WHEELS) :]
    return np.asarray(own[::2] + 1j * own[1::2])
