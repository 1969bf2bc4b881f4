"""A wrong number, in the bench file or in what a controller reports, lets no hanging robot go."""

import pytest
from wrong_numbers import cases, drive, red

from tests.selected import every

CASES = [pytest.param(case, id=case.name) for case in cases()]


@pytest.mark.parametrize("case", every(97, CASES))
def test_nothing_lets_a_hanging_robot_go_on_the_word_of_one_number(case):
    end = drive(case, seed=8900)
    assert not red(end), end
