"""A package whose code fails while it is in use is named, with its device and what to do: exit 3."""

import pytest
from faulty_package import CHIP, PACKAGE, TABLES, driver

FAILING = {
    "a constructor": (driver("__init__ = fail"), "its constructor raised RuntimeError: boom"),
    "open": (driver("open = fail"), "open() raised RuntimeError: boom"),
    "open for the system": (
        driver("def open(self): raise OSError(5, 'gone')"), "open() raised OSError: [Errno 5] gone",
    ),
    "an end of the process": (driver("def read(self): sys.exit(7)"), "read() raised SystemExit: 7"),
    "nothing": (driver("def read(self): return None"), "read() gave None"),
    "a number": (driver("def read(self): return 5"), "read() gave 5"),
    "other samples": (driver("def read(self): return ((1, 2),)"), "read() gave a tuple: (1, 2)"),
    "samples without end": (driver("def read(self): return endless(self)"), "more than 10000 samples"),
    "a stamp of None": (
        driver("def read(self): return (Sample(Stamp(None, 0, 0), 1.0),)"),
        "read() gave Sample.stamp with t_ns None",
    ),
    "a stamp in seconds": (
        driver("def read(self): return (Sample(Stamp(1.5, 0, 0), 1.0),)"),
        "read() gave Sample.stamp with t_ns 1.5",
    ),
    "a value of another type": (
        driver("def read(self): return (replace(self.sample(), value=None),)"), "gave Sample.value None",
    ),
    "emulate": ("ITEM = thing(emulate=fail)\n", "emulate raised RuntimeError: boom"),
}  # fmt: skip


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", FAILING)
def test_the_doctor_names_the_package_and_goes_on(case, package, hil):
    source, told = FAILING[case]
    folder = package("hil-evil", PACKAGE + source, "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == 3, done.said
    (failure,) = [line for line in done.out.splitlines() if line.startswith("FAIL thing")]
    assert "thing (hil-evil 6.6): " in failure
    assert told in failure
    assert "mend hil-evil" in done.out
    assert "ok   imu" in done.out


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", FAILING)
def test_a_run_names_the_package(case, package, hil):
    source, told = FAILING[case]
    folder = package("hil-evil", PACKAGE + source, "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert "thing (hil-evil 6.6): " in done.out + done.said
    assert told in done.out + done.said


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("part", ["identity", "look", "rate_hz"])
def test_the_doctor_names_what_else_of_a_package_fails(part, package, hil):
    source = driver("identity = fail") if part == "identity" else f"ITEM = thing({part}=fail)\n"
    folder = package("hil-evil", PACKAGE + source, "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == 3, done.said
    assert "FAIL thing" in done.out
    assert "thing (hil-evil 6.6): " in done.out
    assert "ok   imu" in done.out


PROMISES = {
    "a hole that is not told": ("return (self.sample(math.nan),)", "NaN or infinity in value", 3),
    "a stamp of the future": ("return (self.sample(ahead_ns=10**10),)", "up to 10 s in the future", 3),
    "a read that waits": ("time.sleep(0.02); return (self.sample(),)", "read() takes 2", 0),
    "none": ("return (self.sample(),)", "ok   thing", 0),
}


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", PROMISES)
def test_the_doctor_tells_of_broken_promises(case, package, hil):
    """A port that is a number is a port, too: of the network."""
    body, told, code = PROMISES[case]
    folder = package("hil-evil", PACKAGE + driver(f"def read(self): {body}"), "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == code, done.out + done.said
    assert told in done.out
    assert ("numbers" in done.out, "stamps" in done.out, "reads:" in done.out) == (
        "hole" in case, "future" in case, "waits" in case,
    )  # fmt: skip


@pytest.mark.usefixtures("bench")
def test_a_model_without_a_wire_says_so(package, hil):
    folder = package("hil-evil", PACKAGE + "ITEM = thing()\n", "ITEM", version="6.6")
    done = hil("emulate", "--bench", "bench.toml", "--only", "thing", packages=[folder])
    assert done.code == 3, done.said
    assert "thing (hil-evil 6.6): model one has no wire face" in done.said


@pytest.mark.usefixtures("bench")
def test_figures_that_fail_are_named_and_the_rest_is_drawn(package, hil, tmp_path, caplog):
    folder = package("hil-evil", PACKAGE + "ITEM = thing(figures=fail)\n", "ITEM", version="6.6")
    assert hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder]).code == 0
    done = hil("replay", tmp_path / "out" / "recording.mcap", "--rerun", "x.rrd", packages=[folder])
    assert done.code == 0, done.said
    assert "hil: wrote x.rrd (" in done.said
    assert caplog.text.count("thing (hil-evil 6.6): figures raised RuntimeError: boom") == 1
    assert (tmp_path / "x.rrd").stat().st_size > 0


@pytest.mark.parametrize(
    ("tables", "told"),
    [
        (f"{TABLES}\n[emulation.thing]\nwrong = 1.0\n", "emulation.thing.wrong: unknown"),
        (
            TABLES.replace("[thing]", "[mocap]") + "\n[emulation.thing]\nx = 1.0\n",
            "emulation.thing: the bench has no",
        ),
    ],
)
def test_imperfections_are_checked_though_the_package_does_not_look(tables, told, package, hil, tmp_path):
    (tmp_path / "bench.toml").write_text(tables)
    source = PACKAGE.replace("driver=driver, emulate", "driver=driver, imperfections=lambda: Truth, emulate")
    truth = "@dataclass(frozen=True)\nclass Truth:\n    x: float = 0.0\n\n\nITEM = thing()\n"
    done = hil("doctor", "--bench", "bench.toml", packages=[package("hil-evil", source + truth, "ITEM")])
    assert done.code == 2
    assert told in done.said


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
def test_an_emulated_device_that_fails_later_is_named_by_whoever_reads_it(case, package, hil):
    body, told = PARTS[case]
    folder = package("hil-evil", PACKAGE + CHIP.format(body=body), "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert f"thing (hil-evil 6.6): {told}" in done.out + done.said
    assert "mend hil-evil" in done.out + done.said
    done = hil("doctor", "--bench", "bench.toml", "--watch", "0.2", packages=[folder])
    assert done.code == 3, done.said
    (failure,) = [line for line in done.out.splitlines() if line.startswith("FAIL")]
    assert f"thing (hil-evil 6.6): {told}" in failure
    assert "ok   imu" in done.out


@pytest.mark.usefixtures("bench")
def test_an_emulator_ends_by_a_device_that_fails(package, hil):
    folder = package("hil-evil", PACKAGE + CHIP.format(body="fail()"), "ITEM", version="6.6")
    done = hil("emulate", "--bench", "bench.toml", "--only", "thing", packages=[folder])
    assert done.code == 3, done.said
    assert "hil: thing (hil-evil 6.6): on_due() of the emulated one raised RuntimeError: boom" in done.said
    assert "Traceback" not in done.said
