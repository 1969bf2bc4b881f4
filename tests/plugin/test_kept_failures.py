"""What a failed test leaves behind, and what the report says of a bench that a test opens by itself."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from hil.replay.recordings import open_recording

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("started_commands")

MINE = """
import hil
import pytest

def test_of_the_fixture(bench):
    bench.observe(0.3, feedback="odometry")
    assert bench.seed == "a sentence of the failure"

def test_of_its_own():
    with hil.open_bench("emulated", seed=5, faults=["imu:off@0.1"]) as bench:
        bench.observe(0.2, feedback="odometry")
    assert not bench.seed

@pytest.mark.parametrize("what", ["a/b", "a_b"])
def test_that_is_named_alike(bench, what):
    bench.observe(0.1, feedback="odometry")
    assert not what

def test_that_passes(bench):
    bench.observe(0.1, feedback="odometry")

def test_without_a_bench():
    assert False
"""


def properties(path):
    """Values of each property of every test case, by name."""
    found = {}
    for case in ElementTree.parse(path).iter("testcase"):
        own = found[case.get("name")] = {}
        for one in case.iter("property"):
            own.setdefault(one.get("name"), []).append(one.get("value"))
    return found


def test_a_failed_test_keeps_its_recording_and_a_page_and_a_passed_one_nothing(pytester):
    pytester.makepyfile(test_mine=MINE)
    old = pytester.path / "kept" / "other" / "file.txt"
    old.parent.mkdir(parents=True)
    old.touch()
    options = ("--junitxml=junit.xml", "-p", "no:cacheprovider", "--hil-keep", "kept")
    result = pytester.runpytest_subprocess(*options)
    result.assert_outcomes(failed=5, passed=1)
    found = properties(pytester.path / "junit.xml")
    failed = ["test_of_the_fixture", "test_of_its_own"]
    failed += [f"test_that_is_named_alike[{what}]" for what in ("a/b", "a_b")]
    for name in failed:
        (recording,), (page,) = found[name]["recording"], found[name]["page"]
        result.stdout.fnmatch_lines([f"test_mine.py::{name.replace('[', '[[]')}: {recording}"])
        opened = open_recording(Path(recording))
        assert len(opened.run(0).records) > 5
        assert name in Path(page).read_text(encoding="utf-8")
    text = Path(found["test_of_the_fixture"]["page"][0]).read_text(encoding="utf-8")
    assert "a sentence of the failure" in text
    assert len({found[name]["recording"][0] for name in failed}) == 4
    assert "recording" not in found["test_that_passes"]
    assert found["test_without_a_bench"] == {}
    assert len(list((pytester.path / "kept").iterdir())) == 4 + 1
    own = found["test_of_its_own"]
    assert {key: own[key] for key in ("bench", "calibration_version", "seed", "held")} == {
        "bench": ["emulated"],
        "calibration_version": ["none"],
        "seed": ["5"],
        "held": ["HELD"],
    }
    assert "imu" in own["emulated"][0]
    assert len(own["fault"]) == 1
    assert own["fault"][0].startswith("imu:off@0.1")


def test_nothing_is_kept_that_was_not_asked_for(pytester):
    pytester.makepyfile(test_mine=MINE)
    options = ("--junitxml=junit.xml", "-p", "no:cacheprovider", "-k", "of_the_fixture or of_its_own")
    pytester.runpytest_subprocess(*options).assert_outcomes(failed=2, deselected=4)
    found = properties(pytester.path / "junit.xml")
    assert found["test_of_the_fixture"]["bench"] == found["test_of_its_own"]["bench"] == ["emulated"]
    assert not any("recording" in own for own in found.values())
    assert [*pytester.path.rglob("*.mcap"), *pytester.path.rglob("*.html")] == []
