"""No hardware moves unless the command line names it: also on benches that tests open by themselves."""

import pytest

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("warm_commands")

RIG = """
schema = 1
name = "rig"

[environment]
surface = "floor"
tilt_rad = 0.0

[imu]
port = "/dev/no-such-port"
"""
OPENS = """
import hil
import pytest
from hil.config.loading import load_bench

def test_the_file():
    hil.open_bench("rig.toml").close()

def test_its_configuration():
    hil.open_bench(load_bench("rig.toml")).close()

def test_another_file():
    hil.open_bench("other.toml").close()

@pytest.mark.opens_stand_ins
def test_stand_ins():
    hil.open_bench("other.toml").close()

def test_emulated():
    hil.open_bench("other.toml", emulate="all").close()
    hil.open_bench("emulated").close()

def test_what_the_fixture_has(bench):
    assert bench.clock.now_ns() > 0
"""
ALWAYS = {"test_stand_ins", "test_emulated"}
OWN = {"test_the_file", "test_its_configuration"}


@pytest.mark.parametrize(
    ("options", "passed", "told"),
    [
        (("-o", "hil_bench=rig.toml"), {*ALWAYS, "test_what_the_fixture_has"}, "--bench FILE"),
        (("--bench=rig.toml",), ALWAYS | OWN, "--bench rig.toml"),
        (("--bench=rig.toml", "--emulate"), {*ALWAYS, "test_what_the_fixture_has"}, "--emulate all"),
    ],
)
def test_a_real_bench_that_the_command_line_does_not_name_is_refused(pytester, options, passed, told):
    (pytester.path / "rig.toml").write_text(RIG)
    (pytester.path / "other.toml").write_text(RIG.replace("no-such-port", "no-other-port"))
    pytester.makepyfile(test_mine=OPENS)
    result = pytester.runpytest_subprocess("-rA", "-p", "no:cacheprovider", *options)
    found = {line.rpartition("::")[2] for line in result.outlines if line.startswith("PASSED")}
    assert found == passed, result.stdout.str()
    refused = [line for line in result.outlines if line.startswith("E ") and "UsageError" in line]
    assert len(refused) == len({"test_another_file", *OWN} - passed)
    assert any(told in line and "emulate" in line for line in refused)


def test_a_bench_that_a_module_opens_when_it_is_imported_is_refused(pytester):
    (pytester.path / "rig.toml").write_text(RIG)
    pytester.makepyfile(
        test_mine="import hil\nBENCH = hil.open_bench('rig.toml')\n\ndef test_it():\n    pass\n"
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines("*UsageError: bench rig.toml: imu real*")
