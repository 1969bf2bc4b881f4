"""How much of many like cases runs by default: an even spread of listed ones, a number of drawn ones."""

import pytest
from hypothesis import settings

DRAWS = 50
"""Number of examples that a property test draws by default."""


def draws(number, **other):
    """Settings of a property test that draws `number` examples by default; more in a thorough run."""
    return settings(max_examples=max(1, number * settings().max_examples // DRAWS), **other)


def every(step, cases):
    """All cases for `pytest.mark.parametrize`, each but every `step`-th marked `long`.

    A case is one value, a tuple of values of several arguments, or a `pytest.param`.
    """
    marked = []
    for k, case in enumerate(cases):
        if not hasattr(case, "marks"):
            case = pytest.param(*(case if isinstance(case, tuple) else (case,)))
        marked.append(case if k % step == 0 else case._replace(marks=(*case.marks, pytest.mark.long)))
    return marked
