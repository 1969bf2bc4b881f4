"""Finds drive and steering columns that are late, or that hold the angles of other wheels.

Each wheel's moves over 0.2 s are compared with those of the ground truth at its place. A change of columns
predicts by how much these moves change. It is named where that is what the moves lack: their regression on
the change is about 1, and most of the difference goes with it. Tolerances of a robot and slip do neither.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence

from hil.core.signals import WHEELS
from hil.datasets.column_moves import GRID_S, IN_ORDER, MOST, Change, Moves, Support
from hil.datasets.nominal_robot import Nominal
from hil.datasets.recording_names import repetition_of
from hil.datasets.wheel_log import Recording
from hil.datasets.wrong_signs import wrong_signs

_STEPS = (4, 2, 1)
"""Steps of the search for a delay, in steps of the grid."""
_LACKS_ORDER, _LACKS = 0.05, 0.1
"""Share of a typical move that enough moves of a wheel lack where an exchange, or a delay, is looked for."""
_MAYBE, _ALIKE = 0.8, 0.98
_ORDERS = tuple(itertools.permutations(IN_ORDER))[1:]

_BY_ONE = ": stamp all columns by one clock"
_OF_ONE = "its column {}{} comes {{:.2f}} s {{}} than those of the other wheels" + _BY_ONE
_OF_WHEEL = "its columns of the {} wheel (phi, delta) come {{:.2f}} s {{}} than the others'" + _BY_ONE
_OF_PHI = "its wheel angles (phi) come {:.2f} s {} than its steering angles (delta)" + _BY_ONE
_OF_DELTA = "its steering angles (delta) come {:.2f} s {} than its wheel angles (phi)" + _BY_ONE
_OF_TRUTH = (
    ("x of its ground truth comes {:.2f} s {} than its y and theta" + _BY_ONE, (1, 0, 0)),
    ("y of its ground truth comes {:.2f} s {} than its x and theta" + _BY_ONE, (0, 1, 0)),
    ("the heading of its ground truth comes {:.2f} s {} than its positions" + _BY_ONE, (0, 0, 1)),
    ("the positions of its ground truth come {:.2f} s {} than its heading" + _BY_ONE, (1, 1, 0)),
    ("", (1, 1, 1)),
)


def with_misplaced_columns(recordings: Sequence[Recording], nominal: Nominal) -> list[Recording]:
    """The recordings; `contradictions` name columns that are late or of another wheel.

    A cause that explains two recordings is looked for in each of the others. Those that it would spoil are
    left alone. Those that cannot tell follow the others of their repetition, or the whole set where no
    recording speaks against it.
    Wheels of which both columns are exchanged are left to `hil.datasets.odd_wheels`, and what another sign
    explains to `hil.datasets.wrong_signs`.

    Args:
        recordings: recordings to check.
        nominal: robot that they are read for.
    """
    found = [_supports(one) if _comparable(one) else {} for one in recordings]
    if any(map(_best, found)):
        signed = _of_another_sign(recordings, nominal)
        found = [{} if one in signed else own for one, own in enumerate(found)]
    best = [_best(own) for own in found]
    likely = [one.change.cause for one in best if one is not None and one.change.cause]
    common = max(set(likely), key=lambda cause: (likely.count(cause), cause), default="")
    clear = [own[common] for own in found if common in own and own[common].clear]
    if likely and len(clear) > 1:
        middle = sorted(clear, key=lambda support: support.change.late)[len(clear) // 2]
        judged = {
            k: _support_of(middle.change, one, found[k])
            for k, one in enumerate(recordings)
            if _comparable(one)
        }
        spoilt = _spoilt([one.name for one in recordings], judged)
        best = [middle if k in spoilt else own for k, own in enumerate(best)]
    return [
        one if said is None or not said.change.cause else _contradicted(one, said)
        for one, said in zip(recordings, best, strict=True)
    ]


def _support_of(change: Change, one: Recording, found: Mapping[str, Support]) -> Support | None:
    """How a cause agrees with a recording, as far as it was looked for there; else how this change does."""
    if change.cause in found:
        return found[change.cause]
    moves = Moves.of(one, 0.0)
    return None if moves is None else moves.support(change)


def _spoilt(names: Sequence[str], judged: Mapping[int, Support | None]) -> set[int]:
    """Places of the recordings that a cause spoils, given how it agrees with each.

    Those that cannot tell follow the others of their repetition, or all where none speaks against it.
    """
    shows = {k for k, own in judged.items() if own is not None and own.clear}
    against = {k for k, own in judged.items() if own is not None and own.against}

    def follows(k: int) -> bool:
        own = repetition_of(names[k])
        same = {i for i in judged if repetition_of(names[i]) == own}
        return not against or bool(own and same & shows and not same & against)

    return shows | {k for k in judged.keys() - shows - against if follows(k)}


def _comparable(one: Recording) -> bool:
    return one.has_truth and not one.of_twist and not one.contradictions


def _of_another_sign(recordings: Sequence[Recording], nominal: Nominal) -> set[int]:
    """Places of the recordings that a change of a sign, or of the order of whole wheels, explains."""
    places = [k for k, one in enumerate(recordings) if _comparable(one)]
    explained = wrong_signs([recordings[k] for k in places], nominal).explained.values()
    return {k for i, k in enumerate(places) if any(mask[i] for mask in explained)}


def _contradicted(one: Recording, support: Support) -> Recording:
    return one.contradicted(support.change.in_words())


def _best(found: dict[str, Support]) -> Support | None:
    """The change that explains most of what the moves of a recording lack; None where none is clear.

    One that is corrected or named elsewhere comes first among those that explain as much.
    """
    clear = [one for one in found.values() if one.clear]
    most = max((one.gain for one in clear), default=0.0)
    alike = [one for one in clear if one.gain >= _ALIKE * most]
    return min(alike, key=lambda one: (bool(one.change.cause), -one.gain), default=None)


def _supports(recording: Recording) -> dict[str, Support]:
    """How each change agrees with a recording, by cause; of delays the one that explains most."""
    out = _judged(Moves.of(recording, 0.0))
    best = _best(out)
    if best is not None and not best.change.cause and best.change.late:
        return _judged(Moves.of(recording, GRID_S * best.change.late))
    return out


def _judged(moves: Moves | None) -> dict[str, Support]:
    """How each change agrees with moves, by cause; delays that agree at all are then searched finely."""
    out = dict[str, Support]()
    if moves is None:
        return out

    def judge(changes: Iterable[Change]) -> None:
        for one in map(moves.support, changes):
            if one.change.cause not in out or one.gain > out[one.change.cause].gain:
                out[one.change.cause] = one

    out["turned"] = moves.turned()
    judge(_exchanges() if len(moves.lacking(_LACKS_ORDER)) > 1 else ())
    wheels = moves.lacking(_LACKS)
    judge(change for late in range(-MOST, MOST + 1, _STEPS[0]) for change in _delays(wheels, late))
    for step in _STEPS[1:]:
        near = {
            (cause, late)
            for cause, one in out.items()
            if one.change.late and one.left < _MAYBE
            for late in (one.change.late - step, one.change.late + step)
            if abs(late) <= MOST
        }
        judge(change for c, late in sorted(near) for change in _delays(wheels, late) if change.cause == c)
    return out


def _exchanges() -> Iterator[Change]:
    """All other orders of columns."""
    for order in _ORDERS:
        yield Change(_exchanged("phi", order), phi=order)
        yield Change(_exchanged("delta", order), delta=order)
        yield Change("", phi=order, delta=order)


def _delays(wheels: Sequence[int], late: int) -> Iterator[Change]:
    """Delays, of so many steps of the grid, that may explain what the moves of these wheels lack."""
    for i in wheels if late else ():
        own = [late * (k == i) for k in IN_ORDER]
        yield Change(_OF_ONE.format("phi", i + 1), phi_late=own)
        yield Change(_OF_ONE.format("delta", i + 1), delta_late=own)
        yield Change(_OF_WHEEL.format(WHEELS[i]), phi_late=own, delta_late=own)
    if late and len(wheels) > 1:
        yield Change(_OF_PHI, phi_late=[late] * 4)
        yield Change(_OF_DELTA, delta_late=[late] * 4)
        for cause, columns in _OF_TRUTH:
            yield Change(cause, truth_late=[late * column for column in columns])


def _exchanged(name: str, order: Sequence[int]) -> str:
    """What is wrong where each wheel has to take the columns of `order`."""
    moved = [i for i in IN_ORDER if order[i] != i]
    if len(moved) == 2:
        one, other = moved
        return (
            f"its columns {name}{one + 1} and {name}{other + 1} are exchanged: they hold the angles of "
            f"{WHEELS[other]} and {WHEELS[one]}"
        )
    held = ", ".join(WHEELS[tuple(order).index(i)] for i in IN_ORDER)
    return f"its columns {name}1 to {name}4 hold the angles of {held}"
