"""A driver of another package that never comes back is named, ended, and the robot is held: exit 3."""

import threading

import pytest
from faulty_package import CHIP, PACKAGE, TABLES, driver

from hil.bench.third_party import call_timeout

HANGING = {
    "a system call": "os.read(os.pipe()[0], 1)",
    "a loop that keeps every error": """while True:
            try: time.sleep(0.01)
            except Exception: pass
""",
    "a wait in bench time": "[self.clock.sleep_until_ns(self.clock.now_ns() + 10**6) for _ in iter(int, 1)]",
    "samples that never come": "return self.never()",
}
NEVER = """
    def never(self):
        while True:
            time.sleep(0.01)
        yield
"""
WALL = (
    TABLES
    + """
[environment]
surface = "melamine"
tilt_rad = 1.5707963

[servos]
backend = "emulated"

[tracker]
backend = "emulated"
"""
)


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(call_timeout, "_LOOK_S", 0.03)


def hanging(body):
    return PACKAGE + "import os\nimport threading\n\n\n" + driver(f"def read(self):\n        {body}\n{NEVER}")


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize("case", HANGING)
def test_a_read_that_never_returns_is_named_and_ended(case, package, hil, caplog):
    folder = package("hil-evil", hanging(HANGING[case]), "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert "thing (hil-evil 6.6): read() had not come back after" in done.out + done.said
    assert caplog.text.count("thing (hil-evil 6.6): read() has been running for") == 1


@pytest.mark.usefixtures("bench")
def test_an_emulated_device_that_never_returns_is_named_and_ended(package, hil):
    folder = package("hil-evil", PACKAGE + CHIP.format(body="while True: pass"), "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert "thing (hil-evil 6.6): on_due() of the emulated one had not come back" in done.out + done.said


def test_the_robot_is_held_meanwhile(tmp_path, package, hil, bench):
    (tmp_path / "bench.toml").write_text(WALL)
    folder = package("hil-evil", hanging("while True: pass"), "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert "\nHELD: " in done.out


def test_what_cannot_be_ended_is_said_with_what_to_do(caplog):
    """Here because it does not run in the main thread, which alone hears signals."""
    free = threading.Event()

    def work():
        with call_timeout.with_time_limit("thing", "hil-evil 6.6", "read()"):
            free.wait(60.0)

    thread = threading.Thread(target=work)
    thread.start()
    for _ in range(1000):
        thread.join(0.01)
        if "cannot be ended from here" in caplog.text:
            break
    free.set()
    thread.join()
    assert "thing (hil-evil 6.6): read() has been running for" in caplog.text
    assert "kill -9" in caplog.text


@pytest.mark.usefixtures("bench")
def test_many_short_reads_are_not_one_long_one(package, hil, caplog):
    folder = package("hil-good", hanging("time.sleep(0.05); return (self.sample(),)"), "ITEM")
    assert hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder]).code == 0
    assert "has been running" not in caplog.text


def spoilt(method, body):
    text = f"def {method}(self):\n        {body}\n{NEVER}"
    return PACKAGE + "import os\nimport threading\n\n\n" + driver(text)


@pytest.mark.usefixtures("bench")
def test_an_open_that_never_returns_is_named_and_ended(package, hil, caplog):
    folder = package("hil-evil", spoilt("open", HANGING["a system call"]), "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 3, done.out + done.said
    assert "thing (hil-evil 6.6): open() had not come back after" in done.out + done.said
    assert "a call that gives up after less than 30 s and raises DeviceError" in done.out + done.said
    assert caplog.text.count("thing (hil-evil 6.6): open() has been running for") == 1


@pytest.mark.usefixtures("bench")
@pytest.mark.parametrize(("method", "args"), [("__init__", "self, config, clock"), ("identity", "self")])
def test_a_look_at_a_device_that_never_answers_is_ended(method, args, package, hil):
    body = f"def {method}({args}):\n        while True: pass\n"
    folder = package("hil-evil", PACKAGE + driver(body), "ITEM", version="6.6")
    done = hil("doctor", "--bench", "bench.toml", packages=[folder])
    what = "its constructor" if method == "__init__" else f"{method}()"
    assert f"thing (hil-evil 6.6): {what} had not come back after" in done.out + done.said
    assert done.code != 0, done.out + done.said


@pytest.mark.usefixtures("bench")
def test_a_close_that_never_returns_is_named_and_the_others_are_closed(package, hil, caplog):
    folder = package("hil-evil", spoilt("close", "while True: pass"), "ITEM", version="6.6")
    done = hil("run", "look.py", "--bench", "bench.toml", "--out", "out", packages=[folder])
    assert done.code == 0, done.out + done.said
    assert "thing (hil-evil 6.6): close() had not come back after" in caplog.text


def test_the_time_outs_of_a_table_are_added_up():
    from hil.config.mocap import MocapConfig
    from hil.config.tracker import T265Config

    assert MocapConfig(open_timeout_s=7.0).timeouts_s() == 7.0
    assert T265Config(connect_timeout_s=20.0, open_timeout_s=6.0).timeouts_s() == 26.0
