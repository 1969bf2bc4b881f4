"""A person at the page, in a real browser: starts, is asked, sees PASS; the page dies, and STOP works."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from hil.console import jobs
from hil.console.jobs import signal_process
from hil.console.json_files import read
from hil.console.stop_server import IDENTITY, PAGE, STOP
from tests.chromium import CHROMIUM, Browser
from tests.console.test_jobs import HELD, job_in, wait_until
from tests.patience import patient_bench

pytestmark = [pytest.mark.long, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")]

ASKING = '''
"""Asks for a colour."""
from hil.procedure import procedure


@procedure(name="asking", needs=())
def run(ctx):
    """Ask."""
    with ctx.step("a question"):
        ctx.note("the colour is " + ctx.prompt("which colour?"))
'''
ASKING_THRICE = '''
"""Asks for three colours."""
from hil.procedure import procedure


@procedure(name="asking_thrice", needs=())
def run(ctx):
    """Ask."""
    with ctx.step("three questions"):
        colours = [ctx.prompt(f"which colour is {place}?") for place in ("first", "second", "third")]
        ctx.note("the colours are " + ", ".join(colours))
'''


class Console:
    """`hil console` in a folder, as a user starts it."""

    def __init__(self, place, results="out"):
        self.folder = place / results / "console"
        self._place, self._results = place, results
        self.start()

    def start(self):
        (self.folder / PAGE).unlink(missing_ok=True)
        command = [sys.executable, "-m", "hil", "console", "--json", "--in", self._results]
        self.process = subprocess.Popen(command, cwd=self._place, stdout=subprocess.PIPE, text=True)
        self.url = json.loads(self.process.stdout.readline())["url"]
        self.frame = f"http://127.0.0.1:{read(self.folder / PAGE)['port']}"

    def kill(self):
        self.process.kill()
        self.process.communicate()

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=30)


@pytest.fixture(params=["out"])
def console(tmp_path, request):
    (tmp_path / "asking.py").write_text(ASKING)
    (tmp_path / "asking_thrice.py").write_text(ASKING_THRICE)
    made = Console(tmp_path, request.param)
    yield made
    if made.process.poll() is None:
        made.end()
    stop = [sys.executable, "-m", "hil", "console", "--in", request.param, "--stop"]
    subprocess.run(stop, cwd=tmp_path, check=True)
    stop = read(made.folder / STOP)
    if stop:
        signal_process({key: stop.get(key) for key in IDENTITY}, signal.SIGTERM)


def opened(console, profile, *size):
    browser = Browser(profile, *size)
    browser.open(console.url)
    browser.until("document.querySelector('#form #start') !== null", console.frame)
    return browser


def start(browser, console, action, **values):
    filled = "".join(
        f"document.querySelector('[name=\"{name}\"]').value = '{v}';" for name, v in values.items()
    )
    code = f"choose('{action}'); {filled} document.querySelector('#start').click(); true"
    assert browser.ask(code, console.frame)


def answer(browser, console, question, text):
    """Fill in and press `Done` twice, and Enter, as soon as the page takes an answer."""
    browser.until(
        f"document.querySelector('.question')?.innerText.includes('{question}')"
        " && !document.querySelector('.question button').disabled",
        console.frame,
    )
    code = f"""(() => {{
        const form = document.querySelector(".question form");
        const found = form.querySelector("input").value;
        form.querySelector("input").value = "{text}";
        form.querySelector("button").click(); form.querySelector("button").click(); form.requestSubmit();
        return [found];
    }})()"""
    assert browser.ask(code, console.frame) == [""], "nothing of the question before is left in the field"


def test_no_click_answers_a_question_that_was_not_shown(console, tmp_path):
    browser = opened(console, tmp_path / "profile")
    try:
        start(browser, console, "a procedure of your own", SCRIPT="asking_thrice.py")
        eager = """(new MutationObserver(() => document.querySelector(".question button")?.click())).observe(
            document.getElementById("now"), { childList: true })"""
        browser.ask(f"{eager}; true", console.frame)  # a click that is on its way while the next one appears
        answer(browser, console, "which colour is first?", "red")
        browser.until(
            "document.querySelector('.question')?.innerText.includes('which colour is second?')"
            " && !document.querySelector('.question button').disabled",
            console.frame,
        )
        other = """(async () => {
            const form = document.querySelector(".question form");
            const job = (await (await fetch("/api/state")).json()).jobs[0];
            const body = JSON.stringify({ job: job.name, question_id: job.question_id, text: "blue" });
            const headers = { "Content-Type": "application/json" };
            await fetch("/api/answer", { method: "POST", headers, body });
            form.querySelector("input").value = "black";
            form.dispatchEvent(new Event("submit", { cancelable: true }));
            return form.querySelector("button").disabled;
        })()"""
        assert browser.ask(other, console.frame), "another browser was first"
        browser.until(
            "document.getElementById('trouble').innerText.includes('that is not the question any more')",
            console.frame,
        )
        answer(browser, console, "which colour is third?", "green")
        browser.until("document.getElementById('verdict')?.innerText === 'PASS'", console.frame)
        (result,) = console.folder.parent.rglob("result.json")
        assert json.loads(result.read_text())["notes"] == ["the colours are red, blue, green"]
    finally:
        browser.close()


def test_a_person_starts_is_asked_sees_the_verdict_and_opens_the_report(console, tmp_path):
    browser = opened(console, tmp_path / "profile")
    try:
        start(browser, console, "bring_up", watch_s="1")
        wrong = "document.querySelector('.field:has([aria-invalid=true])')?.innerText"
        assert "greater than or equal to 2" in browser.until(wrong, console.frame)
        start(browser, console, "a procedure of your own", SCRIPT="asking.py")
        browser.until(
            "document.querySelector('.question')?.innerText.includes('which colour?')", console.frame
        )
        browser.until("document.getElementById('now').innerText.includes('asking.py asks: which colour?')")
        answer(browser, console, "which colour?", "blue")
        browser.until("document.getElementById('verdict')?.innerText === 'PASS'", console.frame)
        link = browser.until("document.querySelector('#now a')?.href", console.frame)
        browser.until("document.querySelectorAll('#history a').length === 1", console.frame)
        browser.open(link)
        browser.until("document.body.innerText.includes('the colour is blue')")
        assert browser.complaints == []
    finally:
        browser.close()


def test_stop_works_when_the_process_of_the_page_is_dead(console, tmp_path):
    browser = opened(console, tmp_path / "profile")
    try:
        start(
            browser,
            console,
            "wall_tracking",
            length_m="0.5",
            duration_s="300",
            feedbacks="ekf",
            cases="x_line",
        )
        browser.until("document.querySelector('#figures')?.innerText.includes('needed')", console.frame, 60.0)
        console.kill()
        browser.until("!document.getElementById('alone').hidden")
        browser.open(console.url.partition("?")[0])  # also a page that is loaded afresh has the button
        browser.until("document.getElementById('now').innerText.includes('wall_tracking runs')")
        time.sleep(1.0)
        assert "wall_tracking runs" in browser.ask("document.getElementById('now').innerText")
        browser.ask("document.getElementById('stop').click()")
        browser.until("document.getElementById('now').innerText.startsWith('wall_tracking: HELD: torque on')")
        console.start()
        browser.until("!document.getElementById('console').hidden")  # the same page goes on with the new one
        browser.until("document.getElementById('verdict')?.innerText === 'ABORTED'", console.frame)
    finally:
        browser.close()


def test_the_alarm_outlives_an_examination_and_goes_when_a_person_says_that_it_is_secured(console, tmp_path):
    left = {"verdict": "ERROR", "held": {"state": "NOT HELD", "moved_m": 0.1, "why": "it slides"}}
    job_in(console.folder / "jobs", out=json.dumps(left), words=["run", "x", "--bench=my.toml"])
    browser = opened(console, tmp_path / "profile")
    try:
        alarm = "document.getElementById('alarm').innerText"
        browser.until(f"{alarm}.startsWith('The robot is NOT HELD since x: it slides.')")
        browser.until("!document.getElementById('examine').disabled", console.frame)
        browser.ask("document.getElementById('examine').click()", console.frame)
        browser.until("document.getElementById('now').innerText.startsWith('doctor: PASS')", limit_s=60.0)
        time.sleep(1.0)
        assert browser.ask(alarm).startswith("The robot is NOT HELD since x")
        browser.ask("document.getElementById('secured').click()")
        browser.until(f"{alarm} === '' && document.getElementById('secure').hidden")
        browser.open(console.url.partition("?")[0])
        browser.until("document.getElementById('now').innerText.startsWith('doctor: PASS')")
        assert browser.ask(alarm) == ""
        eager = """(new MutationObserver((_, seen) => {
            if (document.getElementById("secure").hidden) return;
            seen.disconnect();
            document.getElementById("secured").addEventListener("click", () => { window.taken = true; });
            document.getElementById("secured").click();
            window.tried = true;
        })).observe(document.getElementById("secure"), { attributes: true })"""
        browser.ask(f"{eager}; true")  # a click that is on its way while another alarm appears
        job_in(console.folder / "jobs", "later", out=json.dumps(left), words=["run", "x", "--bench=my.toml"])
        browser.until(
            "!document.getElementById('secure').hidden && !document.getElementById('secured').disabled"
        )
        assert browser.ask("window.tried && !window.taken")
        assert browser.ask(alarm).startswith("The robot is NOT HELD since x")
        browser.ask("document.getElementById('secured').click()")
        browser.until(f"{alarm} === ''")
    finally:
        browser.close()


def test_the_button_comes_back_when_its_own_process_dies(console, tmp_path):
    browser = opened(console, tmp_path / "profile")
    try:
        before = read(console.folder / STOP)
        os.kill(before["pid"], signal.SIGKILL)
        wait_until(lambda: read(console.folder / STOP).get("pid", before["pid"]) != before["pid"])
        after = read(console.folder / STOP)
        assert (after["port"], after["token"]) == (before["port"], before["token"])
        browser.until("document.getElementById('alarm').innerText === ''")
        assert browser.ask("fetch('/state').then((r) => r.status)") == 200
    finally:
        browser.close()


def test_values_of_every_device_are_drawn_and_a_reload_keeps_them(console, tmp_path):
    """Figures as a run tells them; the width of a phone holds them without scrolling sideways."""
    devices = {
        name: {
            "samples": 9,
            "status": "ok",
            "rate_hz": 99.0,
            "due_hz": due,
            "age_ms": 4.0,
            "values": {title: {}},
        }
        for name, due, title in (("imu", 100.0, "Turn rates (rad/s)"), ("my_scale", None, "Mass (kg)"))
    }
    said = ""
    for n in range(40):
        devices["my_scale"]["values"]["Mass (kg)"] = {"mass": n / 8}
        devices["imu"]["values"]["Turn rates (rad/s)"] = {"x": n / 4, "y": None, "z": -n / 4}
        pose = [n / 100, 0.0, 0.0]
        figures = {"t_s": n / 2, "pose": pose, "twist": pose, "reference": None, "adhesion_n": None}
        figures |= {"adhesion_needed_n": None, "wheel_rad_s": None, "steering_rad": None}
        said += json.dumps({"live": {**figures, "devices": devices, "events": []}}) + "\n"
    job_in(console.folder / "jobs", out=json.dumps({"ended": "duration", "held": HELD}), err=said)
    browser = opened(console, tmp_path / "profile", 390, 900)
    try:
        browser.until("rows.length === 40 && trail.length >= 40", console.frame)
        drawn = """[...document.querySelectorAll('#plots [data-device=my_scale] path')].map(
            (path) => path.getAttribute('d').split('L').map((point) => Number(point.split(',').at(-1))))"""
        browser.until(f"({drawn})[0]?.length === 40", console.frame)
        (heights,) = browser.ask(drawn, console.frame)
        assert heights == sorted(heights, reverse=True), "a mass that grows goes up"
        assert (heights[0], heights[-1]) == (58.0, 2.0)
        assert "4.88" in browser.ask(
            "document.querySelector('#plots [data-device=my_scale] .values').innerText", console.frame
        )
        assert browser.ask("document.documentElement.scrollWidth <= 390", console.frame)
        assert browser.complaints == []
    finally:
        browser.close()


def test_a_button_moves_the_robot_while_it_is_held(console, tmp_path):
    """The mouse presses and lets go; a page that loses the focus counts as let go."""
    bench = patient_bench(
        tmp_path, "emulated_floor", **dict.fromkeys(("encoders", "imu", "tracker", "mocap"))
    )
    with contextlib.closing(Browser(tmp_path / "profile")) as browser:
        browser.open(console.url)
        browser.until("document.querySelector('#form #start') !== null", console.frame)
        assert browser.ask(
            f"""choose('jog'); document.querySelector("[name='--bench']").value = '{bench.name}';
            document.querySelector("[name=moves]").value = 'body';
            document.querySelector('#start').click(); true""",
            console.frame,
        )
        browser.until("!at('hold').hidden", console.frame, 240.0)
        (job,) = jobs.jobs(console.folder / "jobs")
        place = browser.ask(
            """(() => { const button = document.querySelector('[data-key=w]');
            button.scrollIntoView({block: 'center'}); const r = button.getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2]; })()""",
            console.frame,
        )
        frame = browser.ask(
            """(() => { const r = document.querySelector('iframe').getBoundingClientRect();
            return [r.x, r.y]; })()"""
        )
        place = [place[0] + frame[0], place[1] + frame[1]]

        def speed():
            return jobs.state(job)["live"]["twist"][0]

        for let_go in ("mouse", "blur"):
            browser.mouse("Pressed", *place, button="left", clickCount=1)
            wait_until(lambda: speed() > 0.005)
            if let_go == "blur":
                browser.ask("window.dispatchEvent(new Event('blur')); true", console.frame)
            else:
                browser.mouse("Released", *place, button="left", clickCount=1)
            wait_until(lambda: abs(speed()) < 0.001)
        assert browser.ask("at('trouble').textContent", console.frame) == ""
        assert not browser.complaints
