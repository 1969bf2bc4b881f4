"""Which of many like cases run by default: an even spread of them; the others are marked `long`."""

import pytest


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
