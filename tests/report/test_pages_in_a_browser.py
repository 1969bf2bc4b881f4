"""Every kind of page in a real browser: small, silent, alone, readable on phone and desk, light and dark."""

import json
import re
from pathlib import Path

import pytest
from every_page import make_every_page

from tests.chromium import CHROMIUM, Browser

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine to render the pages in"),
]

KINDS = (
    "run",
    "comparison",
    "replay",
    "calibration",
    "evaluation",
    "campaign",
    "campaigns",
    "trends",
    "commissioning",
    "robot",
    "acceptance",
)
WITH_FIGURES = (
    "run",
    "replay",
    "calibration",
    "evaluation",
    "campaign",
    "campaigns",
    "trends",
    "commissioning",
)
MOST_BYTES = 3_000_000
CHECKS = Path(__file__).with_name("checks.js").read_text()


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    made = make_every_page(tmp_path_factory.mktemp("pages"))
    assert set(made) == set(KINDS)
    return made


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    found = Browser(tmp_path_factory.mktemp("browser") / "profile")
    yield found
    found.close()


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_is_one_small_file_that_begins_with_a_sentence(pages, kind):
    text = pages[kind].read_text(encoding="utf-8")
    assert len(text.encode()) < MOST_BYTES
    lead = re.search(r'<p class="lead">(.*?)</p>', text, re.S)[1]
    assert re.search(r"[.]\s*$", lead), lead
    assert "@media print" in text


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("kind", KINDS)
def test_a_page_is_readable_and_loads_nothing(browser, pages, kind, width, dark):
    browser.show(pages[kind], width, dark=dark)
    browser.run("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert (browser.complaints, browser.requests) == ([], [])
    assert browser.run("matchMedia('(prefers-color-scheme: dark)').matches") == dark
    assert browser.run("document.documentElement.scrollWidth") <= width
    found = browser.run(CHECKS)
    assert found["texts"] > 5
    assert (found["faint"], found["cut"]) == ([], [])
    said = browser.run("document.body.innerText")
    assert not re.search(r"\b(?i:nan|inf|undefined)\b|\bNone\b|\bnull\b", said), said
    assert browser.run("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")


def first_plot(browser):
    """Where the first axes of the first figure are on the screen, in px: left, top, width, height."""
    return json.loads(
        browser.run("""(() => {
        const plot = document.querySelector("[data-readings]");
        plot.scrollIntoView({ block: "center" });
        const known = JSON.parse(plot.dataset.readings);
        const frame = plot.querySelector(".over").getBoundingClientRect();
        const scale = frame.width / known.size[0], [x, y, w, h] = known.axes[0].box;
        return JSON.stringify([frame.left + x * scale, frame.top + y * scale, w * scale, h * scale]);
    })()""")
    )


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("kind", WITH_FIGURES)
def test_pointing_at_a_figure_reads_its_values(browser, pages, kind, width):
    browser.show(pages[kind], width)
    left, top, wide, tall = first_plot(browser)
    browser.mouse("Moved", left + wide / 2, top + tall / 2)
    said = browser.run("document.querySelector('.said').innerText")
    assert re.search(r"\d", said), said
    box = json.loads(browser.run("JSON.stringify(document.querySelector('.said').getBoundingClientRect())"))
    assert box["left"] >= 0
    assert box["right"] <= width
    browser.mouse("Moved", 2, 2)
    assert browser.run("document.querySelector('.said').hidden")
    assert browser.complaints == []


def ticks(browser):
    return browser.run("[...document.querySelectorAll('.over text')].map((t) => +t.textContent)")


def test_a_part_of_a_figure_is_enlarged_and_shown_whole_again(browser, pages):
    browser.show(pages["replay"], 1280)
    left, top, wide, tall = first_plot(browser)
    whole = browser.run(
        "JSON.parse(document.querySelector('[data-readings]').dataset.readings).axes[0].x.limits"
    )
    assert ticks(browser) == []
    begin, end = (left + 0.4 * wide, top + 0.2 * tall), (left + 0.6 * wide, top + 0.8 * tall)
    browser.mouse("Pressed", *begin, button="left", clickCount=1)
    browser.mouse("Moved", *end, button="left", buttons=1)
    browser.mouse("Released", *end, button="left", clickCount=1)
    shown = ticks(browser)
    low, high = (whole[0] + share * (whole[1] - whole[0]) for share in (0.4, 0.6))
    along = [v for v in shown if low - 1e-9 <= v <= high + 1e-9]
    assert len(along) >= 2
    assert browser.run("document.querySelectorAll('.over path').length") > 0
    for _ in range(2):
        browser.mouse("Pressed", *begin, button="left", clickCount=2)
        browser.mouse("Released", *begin, button="left", clickCount=2)
    assert ticks(browser) == []


def test_a_figure_is_read_by_keyboard(browser, pages):
    browser.show(pages["run"], 1280)
    browser.run("document.querySelector('[data-readings]').focus()")

    def press(key):
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)
        return browser.run("document.querySelector('.said').innerText")

    reported = [press("ArrowRight") for _ in range(8)]
    assert len(set(reported)) > 4
    press("+")
    assert len(ticks(browser)) > 0
    press("0")
    assert ticks(browser) == []
    browser.call("Input.dispatchKeyEvent", type="keyDown", key="Escape", code="Escape")
    assert browser.run("document.querySelector('.said').hidden")


def test_two_fingers_enlarge_a_figure(browser, pages):
    browser.show(pages["run"], 390)
    left, top, wide, tall = first_plot(browser)
    middle, y = left + wide / 2, top + tall / 2

    def touch(kind, gap):
        points = [{"x": middle - gap, "y": y, "id": 0}, {"x": middle + gap, "y": y, "id": 1}] if gap else []
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    touch("touchStart", 20)
    for gap in (30, 45, 60):
        touch("touchMove", gap)
    touch("touchEnd", 0)
    assert len(ticks(browser)) > 0


def test_print_shows_what_is_folded(browser, pages, tmp_path: Path):
    browser.show(pages["run"], 1280)
    browser.call("Emulation.setEmulatedMedia", media="print")
    hidden = browser.run("""[...document.querySelectorAll('details:not([open])')].filter(
        (d) => ![...d.children].some((e) => e.tagName !== "SUMMARY" && e.getClientRects().length)).length""")
    browser.call("Emulation.setEmulatedMedia", media="")
    assert hidden == 0
