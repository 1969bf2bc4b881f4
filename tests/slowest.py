"""Prints the slowest tests of a run of several pytest processes, from the JUnit files in a folder.

Set-up counts for the test that asked for it first: what a fixture costs is shared by those behind it.
"""

import sys
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

SHOWN = 20


def durations(folder):
    """Seconds by test, (file, name), over all files of a folder."""
    found = defaultdict(float)
    for path in sorted(folder.glob("*.xml")):
        for case in ElementTree.parse(path).iter("testcase"):
            found[case.get("classname", "").replace(".", "/"), case.get("name")] += float(case.get("time", 0))
    return found


def table(found):
    """Lines: the slowest tests, then all tests together."""
    slowest = sorted(found.items(), key=lambda item: -item[1])[:SHOWN]
    lines = [f"{seconds:7.1f} s  {file}.py::{name}" for (file, name), seconds in slowest]
    return [*lines, f"{sum(found.values()):7.1f} s  all {len(found)}"]


if __name__ == "__main__":
    print(*table(durations(Path(sys.argv[1]))), sep="\n")
