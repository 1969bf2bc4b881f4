"""A repetition that two worlds share: every motion once, in one of them, under the name it has alone."""

from pathlib import Path

import pytest

from hil.procedure.odometry_motions import MOTIONS, Repetition, Sizes, reference


@pytest.mark.parametrize("motions", [MOTIONS, MOTIONS[:1], MOTIONS[:3]])
def test_every_motion_is_driven_once(motions):
    whole = Repetition(Path("x"), motions, 3, Sizes())
    halves = whole.halves()
    assert sorted(m for half in halves for m in half.motions) == sorted(motions)
    assert all(half.motions for half in halves)
    assert {half.file(m) for half in halves for m in half.motions} == {whole.file(m) for m in motions}
    assert len({half.part for half in halves}) == len(halves)


def test_both_take_as_long():
    start = (0.0, 0.0, 0.0)
    took = [
        sum(reference(m, start, half.sizes).duration_s for m in half.motions)
        for half in Repetition(Path("x"), MOTIONS, 1, Sizes()).halves()
    ]
    assert took[0] == pytest.approx(took[1], rel=0.01)
