"""Which tests run beside which, and the list of the slowest, are about tests that exist."""

import re
from pathlib import Path

import pytest

from tests.lanes import ALONE, REAL_TIME, THINNED, WIRED
from tests.slowest import durations, table

TESTS = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("begin", [*REAL_TIME, *ALONE, *THINNED, *WIRED])
def test_every_entry_means_a_test_that_is_there(begin):
    path, _, name = begin.partition("::")
    assert (TESTS / path).exists()
    assert not name or re.search(rf"^def {name}", (TESTS / path).read_text(encoding="utf-8"), re.MULTILINE)


def test_the_slowest_of_all_processes_come_first(tmp_path):
    case = '<testcase classname="tests.a" name="test_{0}[x.y]" time="{0}"/>'
    for name, seconds in (("virtual", range(30)), ("alone", (40, 50))):
        cases = "".join(case.format(s) for s in seconds)
        (tmp_path / f"{name}.xml").write_text(f"<testsuites><testsuite>{cases}</testsuite></testsuites>")
    lines = table(durations(tmp_path))
    assert lines[0].split() == ["50.0", "s", "tests/a.py::test_50[x.y]"]
    assert [float(line.split()[0]) for line in lines[:20]] == [50, 40, *range(29, 11, -1)]
    assert lines[20].split() == ["525.0", "s", "all", "32"]
