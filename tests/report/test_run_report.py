"""The page of a run: complete, self-contained, rendered by a browser without a network."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from types import SimpleNamespace

import matplotlib as mpl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.bench import BenchConfig
from hil.procedure import BenchSource, Measurement, procedure
from hil.procedure.runner import RunOptions, run_procedure
from hil.report.compare_page import compare, comparison_text, write_compare_page
from hil.report.figures import figure_image, themed_svg
from hil.report.result_file import read_result
from hil.report.run_page import bar, write_run_page
from hil.report.run_plots import PALETTE, legend, new_figure, plain_log, style
from hil.vocabulary.clock import MonotonicClock
from hil.vocabulary.errors import DataError, UsageError

SCRIPTED = SimpleNamespace(ask=lambda question: "yes")


@procedure(
    name="shown",
    measurements=(
        Measurement("inside", "mm", low=0.0, high=10.0, rationale="<b>reason</b> & more"),
        Measurement("near", "deg", high=2.0, marginal=0.5),
        Measurement("outside", "mm", high=1.0),
        Measurement("told", "s"),
    ),
)
def shown(ctx):
    """Leaves one of everything."""
    with ctx.step("draw"):
        ctx.measure("inside", 4.25)
        ctx.measure("near", 1.75)
        ctx.measure("outside", 1.5)
        ctx.measure("told", 12.0)
        for k in range(2):
            figure = new_figure()
            axes = style(figure.add_subplot(), "time (s)", "x (m)")
            axes.plot([0, 1], [0, k], color=PALETTE["c1"], label="EKF <1>")
            legend(axes)
            ctx.figure(figure, f"Figure {k}", "a caption")
    ctx.table("Ends & means", ["case", "mm"], [["x <y>", 1.0]], "in mm")
    ctx.note("look & see")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "run"
    source = BenchSource(BenchConfig(schema=1, name="bare"))
    run_procedure(shown, source, RunOptions(out, MonotonicClock(), "2026-01-01", {}, operator=SCRIPTED))
    write_run_page(out)
    return out


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.urls = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.urls += [v for k, v in attrs if k in ("src", "href", "xlink:href")]

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_says_everything_in_order_and_escapes_it(folder):
    page = Page((folder / "report.html").read_text())
    text = " ".join(" ".join(page.text).split())
    order = ["FAIL", "1 fail, 1 marginal, 1 pass", "inside", "4.25", "<b>reason</b> & more", "outside",
             "look & see", "Figure 0", "Figure 1", "Ends & means", "x <y>", "To repeat it"]  # fmt: skip
    at = [text.index(word) for word in order]
    assert at == sorted(at)


def test_the_page_needs_nothing_from_outside(folder):
    text = (folder / "report.html").read_text()
    page = Page(text)
    assert not [u for u in page.urls if re.match(r"(https?:)?//", u or "")]
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)
    assert "script" not in page.tags
    assert "prefers-color-scheme: dark" in text
    assert 'name="viewport"' in text


def test_figures_follow_the_theme_and_the_width(folder):
    path = next((folder / "figures").glob("01_*.svg"))
    svg = themed_svg(path)
    assert svg.startswith("<svg")
    assert "var(--c1)" in svg
    assert PALETTE["c1"] not in svg
    assert "#000000" not in svg
    assert "prefers-color-scheme: dark" in svg
    assert "EKF &lt;1&gt;" in svg
    image = str(figure_image(path, 'one "1"'))
    assert image.startswith(
        '<img alt="one &#34;1&#34;" style="max-width:622px" src="data:image/svg+xml;base64,'
    )


def test_every_text_of_a_figure_takes_the_colour_of_the_page(tmp_path):
    figure = new_figure()
    axes = style(figure.add_subplot(), "$x_0$", "mm")
    axes.plot([1, 2], [1.0, 1000.0])
    axes.set_yscale("log")
    plain_log(axes)

    with mpl.rc_context({"svg.fonttype": "none"}):
        figure.savefig(tmp_path / "02_plain.svg", format="svg")
        axes.set_yscale("log")
        figure.savefig(tmp_path / "03_powers.svg", format="svg")
    for name in ("02_plain", "03_powers"):
        svg = themed_svg(tmp_path / f"{name}.svg")
        assert svg.count("<text") == svg.count('<text fill="currentColor"') > 3
    assert ">1000<" in themed_svg(tmp_path / "02_plain.svg").replace(" ", "")


@given(st.floats(-1e3, 1e3) | st.none(), st.floats(-1e3, 1e3) | st.none(), st.floats(0, 1e3), st.booleans())
def test_the_bar_shows_inside_as_inside(value, low, width, both):
    row = {"value": value, "low": low, "high": None if low is None else (low + width if both else None)}
    drawn = bar(row)
    if value is None or low is None:
        assert drawn is None
        return
    assert 0.0 <= drawn["start"] <= drawn["start"] + drawn["width"] <= 100.02
    assert 0.0 <= drawn["value"] <= 100.0
    if width > 1e-3 and abs(low) > 1e-3:
        inside = value >= low and (row["high"] is None or value <= row["high"])
        margin = 0.02
        end = drawn["start"] + drawn["width"]
        if inside:
            assert drawn["start"] - margin <= drawn["value"] <= end + margin
        else:
            assert drawn["value"] <= drawn["start"] + margin or drawn["value"] >= end - margin


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot be read"),
        ("{", "is not JSON"),
        ("[]", "not the result"),
        ('{"schema": 1}', "not the result"),
    ],
)
def test_a_folder_that_is_no_run_is_named(tmp_path, content, words):
    if content is not None:
        (tmp_path / "result.json").write_text(content)
    with pytest.raises(DataError, match=words) as caught:
        read_result(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_lost_figure_is_named(folder, tmp_path):
    shutil.copy(folder / "result.json", tmp_path)
    with pytest.raises(DataError, match=r"figure_0\.svg"):
        write_run_page(tmp_path)


def test_runs_are_compared_measurement_by_measurement(folder, tmp_path):
    tree = json.loads((folder / "result.json").read_text())
    tree["measurements"][2]["value"] = 0.5
    tree["measurements"][2]["outcome"] = "PASS"
    tree["parameters"] = {"gain": 2}
    del tree["measurements"][3]
    (tmp_path / "result.json").write_text(json.dumps(tree))
    table = compare([folder, tmp_path])
    rows = {r["name"]: r for r in table["measurements"]}
    assert (rows["outside"]["change"], rows["outside"]["ratio"]) == (-1.0, 0.5 / 1.5)
    assert rows["outside"]["outcomes"] == ["FAIL", "PASS"]
    assert rows["told"]["values"] == [12.0, None]
    assert table["differences"] == [{"key": "parameters.gain", "values": ["–", "2"]}]
    assert "outside" in comparison_text(table)
    page = Page(write_compare_page(tmp_path / "compare.html", table).read_text())
    assert "parameters.gain" in " ".join(page.text)


def test_different_procedures_are_not_compared(folder, tmp_path):
    tree = json.loads((folder / "result.json").read_text()) | {"procedure": "other"}
    (tmp_path / "result.json").write_text(json.dumps(tree))
    with pytest.raises(UsageError, match="other, shown"):
        compare([folder, tmp_path])


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine to render the page in")
@pytest.mark.parametrize("width", [1200, 500])
def test_a_browser_shows_the_page_without_overflow(folder, tmp_path, width):
    probe = re.sub("<meta http-equiv=[^>]*>", "", (folder / "report.html").read_text()).replace(
        "</body>",
        "<script>document.title = [document.documentElement.scrollWidth, innerWidth,"
        " getComputedStyle(document.querySelector('.verdict strong')).display,"
        " document.querySelectorAll('figure img').length,"
        " Math.min(...[...document.querySelectorAll('figure img')]"
        ".map(i => i.naturalWidth && i.clientWidth))].join(' ')"
        "</script></body>",
    )  # fmt: skip
    page = tmp_path / "probe.html"
    page.write_text(probe)
    found = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         f"--window-size={width},900", "--dump-dom", f"file://{page}"],
        capture_output=True, text=True, timeout=60, check=True,
    ).stdout  # fmt: skip
    title = re.search(r"<title>(.*?)</title>", found)[1].split()
    assert int(title[0]) <= int(title[1])
    assert title[2:4] == ["block", "2"]
    assert int(title[4]) > 250
