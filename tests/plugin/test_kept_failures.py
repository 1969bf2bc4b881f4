"""What a failed test leaves behind, and what the report says of a bench that a test opens by itself."""

from xml.etree import ElementTree

import pytest

from hil.replay.recordings import open_recording

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("warm_commands")

MINE = """
import hil
import pytest

@pytest.mark.parametrize("what", ["a/b", "a_b"])
def test_of_the_fixture(bench, what):
    bench.observe(0.3, feedback="odometry")
    assert bench.seed == "a sentence of the failure"

def test_of_its_own():
    with hil.open_bench("emulated", seed=5, faults=["imu:off@0.1"]) as bench:
        bench.observe(0.2, feedback="odometry")
    assert not bench.seed

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
    result.assert_outcomes(failed=4, passed=1)
    found = properties(pytester.path / "junit.xml")
    failed = ["test_of_its_own", *(f"test_of_the_fixture[{what}]" for what in ("a/b", "a_b"))]
    for name in failed:
        (recording,), (page,) = found[name]["recording"], found[name]["page"]
        result.stdout.fnmatch_lines([f"test_mine.py::{name.replace('[', '[[]')}: {recording}"])
        assert recording.startswith("kept/")
        assert page.startswith("kept/")
        opened = open_recording(pytester.path / recording)
        assert len(opened.run(0).records) > 5
        assert name in (pytester.path / page).read_text(encoding="utf-8")
    text = (pytester.path / found["test_of_the_fixture[a_b]"]["page"][0]).read_text(encoding="utf-8")
    assert "a sentence of the failure" in text
    assert len({found[name]["recording"][0] for name in failed}) == 3
    assert "recording" not in found["test_that_passes"]
    assert found["test_without_a_bench"] == {}
    assert len(list((pytester.path / "kept").iterdir())) == 3 + 1
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


LONG = """
import hil
import pytest

@pytest.fixture(scope="module")
def mine():
    with hil.open_bench("emulated", seed=5) as bench:
        yield bench

def test_that_opens(mine):
    mine.observe(0.1, feedback="odometry")

def test_between(mine):
    mine.observe(0.1, feedback="odometry")
    assert False

def test_that_is_the_last(mine):
    mine.observe(0.1, feedback="odometry")
"""


def test_a_bench_that_outlives_its_test_is_reported_when_it_is_closed(pytester):
    pytester.makepyfile(test_mine=LONG)
    options = ("--junitxml=junit.xml", "-p", "no:cacheprovider", "--hil-keep", "kept")
    result = pytester.runpytest_subprocess(*options)
    found = properties(pytester.path / "junit.xml")
    assert found["test_that_opens"]["seed"] == ["5"]
    assert "held" not in found["test_that_opens"]
    assert found["test_between"] == {}
    last = found["test_that_is_the_last"]
    assert (last["seed"], last["held"]) == (["5"], ["HELD"])
    opened = open_recording(pytester.path / last["recording"][0])
    assert sum(len(run.records) for run in opened.runs) > 25
    assert "test_between" in (pytester.path / last["page"][0]).read_text(encoding="utf-8")
    result.stdout.fnmatch_lines(f"test_mine.py::test_between: {last['recording'][0]}")


SEVERAL = """
import hil
import pytest

def test_three(bench):
    for _ in range(2):
        with hil.open_bench("emulated", seed=5):
            pass
    with hil.open_bench("emulated", seed=6):
        pass
    assert False
"""


def test_each_bench_of_a_test_has_properties_of_its_own_and_a_missing_page_is_none(pytester):
    pytester.makepyfile(test_mine=SEVERAL)
    kept = f"--hil-keep={pytester.path.parent / 'kept'}"
    result = pytester.runpytest_subprocess("--junitxml=junit.xml", "-p", "no:cacheprovider", kept)
    found = properties(pytester.path / "junit.xml")["test_three"]
    assert [found[name] for name in ("seed", "seed_2", "seed_3")] == [["0"], ["5"], ["6"]]
    assert [found[name] for name in ("held", "held_2", "held_3")] == [["HELD"]] * 3
    assert "seed_4" not in found
    assert len(found["recording"]) == 4
    assert all(path.startswith(f"{pytester.path.parent}/kept/") for path in found["recording"])
    assert "page" not in found
    result.stdout.fnmatch_lines("test_mine.py::test_three: no page (*)")
