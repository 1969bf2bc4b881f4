"""A package whose code fails while it is in use is named, with its device and what to do: exit 3."""

import json
import sys

import pytest
from faulty_package import CHANNELS, CHIP, PACKAGE, TABLES, driver

from hil.cli import main

FAILING = {
    "a constructor": (driver("__init__ = fail"), "its constructor raised RuntimeError: boom"),
    "open": (driver("open = fail"), "open() raised RuntimeError: boom"),
    "an end of the process": (driver("def read(self): sys.exit(7)"), "read() raised SystemExit: 7"),
    "nothing": (driver("def read(self): return None"), "read() gave None"),
    "other samples": (driver("def read(self): return ((1, 2),)"), "read() gave a tuple: (1, 2)"),
    "samples without end": (driver("def read(self): return endless(self)"), "more than 10000 samples"),
    "a stamp of None": (
        driver("def read(self): return (Sample(Stamp(None, 0, 0), 1.0),)"),
        "read() gave Sample.stamp with t_ns None",
    ),
    "a value of another type": (
        driver("def read(self): return (replace(self.sample(), value=None),)"),
        "gave Sample.value None",
    ),
    "a tuple of another length": (
        driver("def read(self): return (self.sample(pair=(1.0,)),)"),
        "gave Sample.pair (1.0,)",
    ),
    "a number beyond every float": (
        driver("def read(self): return (self.sample(10**400),)"),
        "which no float holds",
    ),
    "a number beyond 64 bits": (
        driver("def read(self): return (self.sample(number=2**63),)"),
        "gave Sample.number 9223372036854775808, which 64 bits do not hold",
    ),
    "a text in a mapping": (
        driver("def read(self): return (self.sample(more={'x': 'y'}),)"),
        "gave Sample.more {'x': 'y'}",
    ),
    "a status too many": (CHANNELS, "gave Two.status of length 3"),
    "emulate": ("ITEM = thing(emulate=fail)\n", "emulate raised RuntimeError: boom"),
}


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", FAILING)
def test_the_doctor_names_the_package_and_goes_on(case, package, hil):
    source, reported = FAILING[case]
    folder = package("hil-evil", PACKAGE + source, "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == 3, done.said
    (failure,) = [line for line in done.out.splitlines() if line.startswith("FAIL thing")]
    assert "thing (hil-evil 6.6): " in failure
    assert reported in failure
    assert "fix hil-evil" in done.out
    assert "ok   imu" in done.out


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", ["open", "nothing", "emulate"])
def test_a_run_names_the_package(case, package, hil):
    source, reported = FAILING[case]
    folder = package("hil-evil", PACKAGE + source, "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert "thing (hil-evil 6.6): " in done.out + done.said
    assert reported in done.out + done.said


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("words", [("run", "look.py", "--out", "out"), ("doctor", "--watch", "0.2")])
def test_the_calls_in_a_package_are_reported(words, package, hil):
    source = PACKAGE + driver("def read(self): return deeper()") + "\ndef deeper(): return fail()\n"
    folder = package("hil-evil", source, "ITEM")
    done = hil(*words, "--bench", "bench.toml", "--json", packages=[folder])
    reported = json.loads(done.out)
    problem = (
        reported["error"] if "error" in reported else next(f for f in reported["findings"] if f["frames"])
    )
    own = [f for f in problem["frames"] if f["file"].endswith("hil_evil.py")]
    assert [frame["function"] for frame in own] == ["read", "deeper", "fail"]
    assert own[-1]["code"] == 'raise RuntimeError("boom")'
    for frame in own:
        assert f'{frame["file"]}", line {frame["line"]}, in' in done.said


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("part", ["identity", "check", "rate_hz"])
def test_the_doctor_names_what_else_of_a_package_fails(part, package, hil):
    source = driver("identity = fail") if part == "identity" else f"ITEM = thing({part}=fail)\n"
    folder = package("hil-evil", PACKAGE + source, "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == 3, done.said
    assert "FAIL thing" in done.out
    assert "thing (hil-evil 6.6): " in done.out
    assert "ok   imu" in done.out


PROMISES = {
    "a hole that is not reported": ("return (self.sample(math.nan),)", "NaN or infinity in value", 3),
    "a hole in a mapping": ("return (self.sample(more={'x': math.nan}),)", "NaN or infinity in more", 3),
    "a stamp of an hour ago": (
        "return (self.sample(ahead_ns=-3600 * 10**9),)",
        "measured 3.6e+03 s before they arrived, usually",
        3,
    ),
    "a stamp that goes back": (
        "return (self.sample(ahead_ns=-10**8 * (self.seq % 2)),)",
        "were measured no later than the one",
        3,
    ),
    "a stamp whose number goes back": (
        "self.seq -= 2; return (self.sample(),)",
        "sequence numbers go back",
        3,
    ),
    "a shape that changes": (
        "return (self.sample(counts=np.zeros(self.seq % 2 + 1)),)",
        "counts changes its shape or its type",
        3,
    ),
    "a stamp of the future": ("return (self.sample(ahead_ns=10**10),)", "up to 10 s in the future", 3),
    "a read that waits": ("time.sleep(0.02); return (self.sample(),)", "read() takes ", 0),
    "none": ("return (self.sample(),)", "ok   thing", 0),
}


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", PROMISES)
def test_the_doctor_reports_broken_promises(case, package, hil):
    """A port that is a number is a port, too: of the network."""
    body, reported, code = PROMISES[case]
    folder = package("hil-evil", PACKAGE + driver(f"def read(self): {body}"), "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == code, done.out + done.said
    assert reported in done.out
    checks = ("numbers", "stamps", "reads", "shapes")
    named = ("hole" in case, "stamp" in case, "waits" in case, "shape" in case)
    assert tuple(f" {check}: " in done.out for check in checks) == named


@pytest.mark.usefixtures("bench")
def test_a_run_reports_once_of_a_hole_that_the_status_does_not(package, hil, tmp_path):
    source = PACKAGE + driver("def read(self): return (self.sample(pair=(1.0, math.nan)),)")
    folder = package("hil-evil", source, "ITEM")
    script = (tmp_path / "look.py").read_text()
    watched, reported = "ctx.bench.observe(0.1)", "ctx.note(f'{e.level} {e.source}: {e.message}')"
    (tmp_path / "look.py").write_text(script.replace(watched, f"[{reported} for e in {watched}.events]"))
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 0, done.out + done.said
    notes = json.loads((tmp_path / "out" / "result.json").read_text())["notes"]
    assert notes == ["warning thing: NaN or infinity in pair with status ok: fix the driver of its package"]


@pytest.mark.usefixtures("bench")
def test_a_model_without_a_wire_says_so(package, hil):
    folder = package("hil-evil", PACKAGE + "ITEM = thing()\n", "ITEM", version="6.6")
    done = hil("emulate", "--bench", "bench.toml", "--only", "thing", packages=[folder])
    assert done.code == 3, done.said
    assert "thing (hil-evil 6.6): model one has no wire transport" in done.said


@pytest.mark.usefixtures("bench")
def test_figures_that_fail_are_named_and_the_rest_is_drawn(
    package, forget, monkeypatch, tmp_path, capfd, caplog
):
    """The page draws them, and another process the view."""
    folder = package("hil-evil", PACKAGE + "ITEM = thing(figures=fail)\n", "ITEM", version="6.6")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(folder), *sys.path])
    forget()
    named = "thing (hil-evil 6.6): figures raised Runtime"
    assert main(["run", "look.py", "--bench", "bench.toml", "--out", "out"]) == 0
    assert caplog.text.count(named) == 1, "the page would draw them"
    assert main(["replay", "out/recording.mcap", "--rerun", "x.rrd"]) == 0
    assert capfd.readouterr().err.count(named) == 1
    assert (tmp_path / "x.rrd").stat().st_size > 0


@pytest.mark.parametrize(
    ("tables", "reported"),
    [
        (f"{TABLES}\n[emulation.thing]\nwrong = 1.0\n", "emulation.thing.wrong: unknown"),
        (
            TABLES.replace("[thing]", "[mocap]") + "\n[emulation.thing]\nx = 1.0\n",
            "emulation.thing: the bench has no",
        ),
    ],
)
def test_imperfections_are_checked_though_the_package_does_not_look(tables, reported, package, hil, tmp_path):
    (tmp_path / "bench.toml").write_text(tables)
    truth = "@dataclass(frozen=True)\nclass Truth:\n    x: float = 0.0\n\n\n"
    source = PACKAGE + truth + "ITEM = thing(truth_options=lambda self: Truth)\n"
    done = hil("doctor", "--bench", "bench.toml", packages=[package("hil-evil", source, "ITEM")])
    assert done.code == 2
    assert reported in done.said


@pytest.mark.usefixtures("bench")
def test_a_fault_may_name_a_kind_by_its_alias(package, hil):
    chip = """
def declaring(setting):
    setting.world.faults.declare("thing", {"off": ()})
    return emulate(setting)


ITEM = thing(emulate=declaring, aliases=("gadget",))
"""
    words = ("doctor", "--bench", "bench.toml", "--watch", "0.1", "--fault", "gadget:off")
    assert hil(*words, packages=[package("hil-evil", PACKAGE + chip, "ITEM")]).code == 0


PARTS = {
    "raises": ("fail()", "on_due() of the emulated one raised RuntimeError: boom"),
    "stands still": ("pass", "on_due() of the emulated one never gets beyond 50000000 ns"),
}


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", PARTS)
def test_an_emulated_device_that_fails_later_is_named_when_it_is_read(case, package, hil):
    body, reported = PARTS[case]
    folder = package("hil-evil", PACKAGE + CHIP.format(body=body), "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert f"thing (hil-evil 6.6): {reported}" in done.out + done.said
    assert "fix hil-evil" in done.out + done.said
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == 3, done.said
    (failure,) = [line for line in done.out.splitlines() if line.startswith("FAIL")]
    assert f"thing (hil-evil 6.6): {reported}" in failure
    assert "ok   imu" in done.out


@pytest.mark.usefixtures("bench")
def test_an_emulator_ends_by_a_device_that_fails(package, hil):
    folder = package("hil-evil", PACKAGE + CHIP.format(body="fail()"), "ITEM", version="6.6")
    done = hil("emulate", "--bench", "bench.toml", "--only", "thing", packages=[folder])
    assert done.code == 3, done.said
    assert "hil: thing (hil-evil 6.6): on_due() of the emulated one raised RuntimeError: boom" in done.said
    assert "Traceback" not in done.said


WRONG_CHECKS = {
    "none": ("lambda self, config: 3", "checks() gave 3"),
    "raising": ("fail", "checks() raised RuntimeError: boom"),
    "of another kind": ("lambda self, config: (LastingCheck('thin', 'low', bool),)", "checks() gave 'thin'"),
}
FAILING_CHECKS = {
    "raises": ("fail(cycle)", "on_samples() of its check raised RuntimeError: boom"),
    "no message": ("cycle.stop('low', None)", "message None"),
}


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", WRONG_CHECKS)
def test_checks_that_are_none_are_named_by_the_doctor_and_before_a_run(case, package, hil):
    given, reported = WRONG_CHECKS[case]
    source = PACKAGE + f"from hil.devkit import LastingCheck\n\nITEM = thing(checks={given})\n"
    folder = package("hil-evil", source, "ITEM", version="6.6")
    for words in (("doctor", "--watch", "0.2"), ("run", "look.py", "--out", "out")):
        done = hil(*words, "--bench", "bench.toml", packages=[folder])
        assert done.code == 3, done.out + done.said
        assert reported in done.out + done.said
        assert "thing (hil-evil 6.6): " in done.out + done.said


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", FAILING_CHECKS)
def test_a_check_that_fails_while_the_robot_runs_names_its_package(case, package, hil):
    body, reported = FAILING_CHECKS[case]
    source = (
        PACKAGE
        + "from hil.devkit import Check\n\n\nclass Own(Check):\n    def on_samples(self, cycle):\n"
        + f"        {body}\n\n\nITEM = thing(checks=lambda self, config: (Own(),))\n"
    )
    folder = package("hil-evil", source, "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert reported in done.out + done.said
    assert "thing (hil-evil 6.6): " in done.out + done.said


SERIAL = """
from hil.devkit import SerialSensorConfig
from hil.devkit.chip import SerialStreamingChip
from hil.devkit.driver import LineParser, SerialSensor
from hil.fakes.emulated_device import on_serial_line


class OnALine(SerialSensorConfig):
    model: Literal["one"] = "one"


@dataclass(frozen=True)
class Truth:
    x: float = 0.0


class Chip(SerialStreamingChip):
    Options = Truth

    def measure(self, t_ns):
        {measure}

    def encode(self, measured):
        return {encode}


class Lines(SerialSensor):
    name = "thing"

    def identify(self, port):
        self.lines = LineParser()
        if port.request(b"", self.lines.feed, lambda x: x, clock=self.clock, timeout_s=1.0) is None:
            raise self.silent("no line")
        return {{"model": "one"}}

    def parse(self, data, now_ns):
        return self.lines.feed(data)

    def sample(self, item, stamp):
        return Sample(stamp, 1.0)


ITEM = thing(Lines, emulate=lambda request: on_serial_line(request, Chip(request)), config=OnALine)
"""


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize(
    ("measure", "encode", "reported"),
    [("fail()", "b'x'", "raised RuntimeError: boom"), ("return 1", "'text'", "encode() gave 'text'")],
)
def test_a_chip_that_fails_while_its_device_is_opened_is_named(measure, encode, reported, package, hil):
    source = PACKAGE + SERIAL.format(measure=measure, encode=encode)
    folder = package("hil-evil", source, "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert reported in done.out
    assert "thing (hil-evil 6.6): on_due() of the emulated one" in done.out
