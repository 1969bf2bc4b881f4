"""The page of a run: complete, self-contained, rendered by a browser without a network."""

import json
import re
import shutil
from html.parser import HTMLParser
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.cli.run import text_of
from hil.config.bench import BenchConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError, UsageError
from hil.procedure import BenchSource, Measurement, procedure
from hil.procedure.run_result import judge
from hil.procedure.runner import RunOptions, run_procedure
from hil.report.compare_page import compare, comparison_text, write_compare_page
from hil.report.hover_data import taken_out
from hil.report.page_figures import figure_image, save_figure, themed_svg
from hil.report.plot_style import PALETTE, legend, new_figure, plain_log, style
from hil.report.result_reader import read_result
from hil.report.run_page import bar, write_run_page
from hil.report.run_summary import grouped, sentence

SCRIPTED = SimpleNamespace(ask=lambda question: "yes")


@procedure(
    name="shown",
    measurements=(
        Measurement("inside", "mm", low=0.0, high=10.0, rationale="<b>reason</b> & more"),
        Measurement("near", "deg", high=2.0, marginal=0.5),
        Measurement("outside", "mm", high=1.0),
        Measurement("reported", "s"),
    ),
)
def shown(ctx):
    """Leaves one of everything."""
    with ctx.step("draw"):
        ctx.measure("inside", 4.25)
        ctx.measure("near", 1.75)
        ctx.measure("outside", 1.5)
        ctx.measure("reported", 12.0)
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
    order = [
        "1 of 3 limits failed: outside 1.5 mm, at most 1 mm.",
        "FAIL",
        "1 fail, 1 marginal, 1 pass",
        "look & see",
        "Figure 0",
        "Figure 1",
        "inside",
        "4.25",
        "<b>reason</b> & more",
        "Reported without a limit (1)",
        "Ends & means",
        "x <y>",
        "To repeat it",
    ]
    text = text[text.index(order[0]) :]
    at = [text.index(word) for word in order]
    assert at == sorted(at)


@pytest.mark.parametrize("confirmed", [True, False])
def test_the_page_says_by_what_the_robot_is_held_and_on_which_keys_that_rests(folder, tmp_path, confirmed):
    keys = ["adhesion.pole_pairs", "thrust.full_force_n"]
    held = {"state": "HELD", "moved_m": 0.001, "why": "at rest", "by": "load cells", "confirmed": confirmed}
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    result = json.loads((tmp_path / "result.json").read_text())
    (tmp_path / "result.json").write_text(json.dumps({**result, "held": {**held, "rests_on": keys}}))
    shown = write_run_page(tmp_path).read_text()
    assert all(f"<code>{key}</code>" in shown for key in keys)
    assert "By the load cells" in shown
    assert ("confirmed by nothing" in shown) is not confirmed


def test_the_page_needs_nothing_from_outside(folder):
    text = (folder / "report.html").read_text()
    page = Page(text)
    assert not [u for u in page.urls if re.match(r"(https?:)?//", u or "")]
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)
    assert page.tags.count("script") == 1
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
    assert image.startswith('<div class="plot" style="max-width:599px" data-readings="{')
    assert '<img alt="one &#34;1&#34;" src="data:image/svg+xml;base64,' in image


def test_what_can_be_read_off_a_figure_is_what_was_drawn(tmp_path):
    figure = new_figure(4.0, 3.0)
    axes = style(figure.add_subplot(), "time (s)", "x (mm)", "a title")
    t_s = np.linspace(0.0, 10.0, 5000)
    peak = np.where(np.arange(5000) == 1234, 9.0, np.sin(t_s))
    axes.plot(t_s, peak, color=PALETTE["c1"], label="EKF")
    axes.axhline(0.5, color=PALETTE["c5"], ls="--")
    axes.fill_between(t_s[:2], [0, 0], [1, 1], color=PALETTE["c2"])
    svg = save_figure(figure, tmp_path / "a.svg").read_text()
    plain, text = taken_out(svg)
    assert "readings" not in plain
    whole = json.loads(text)
    (found,) = whole["axes"]
    assert whole["size"] == [288.0, 216.0]
    assert (found["title"], found["x"]["label"], found["y"]["label"]) == ("a title", "time (s)", "x (mm)")
    line, limit = found["series"]
    assert (line["name"], line["colour"], limit["colour"], limit["dashed"]) == ("EKF", "c1", "c5", True)
    assert len(line["x"]) <= 400
    assert (line["x"][0], line["x"][-1], max(line["y"])) == (0.0, 10.0, 9.0)
    assert limit["y"] == [0.5, 0.5]
    assert found["areas"][0]["colour"] == "c2"
    left, top, width, height = found["box"]
    frame = re.search(r'id="patch_2">\s*<path d="M (\S+) (\S+) \nL (\S+) \S+ \nL \S+ (\S+)', svg)
    assert [left, top + height, left + width, top] == pytest.approx(
        [float(v) for v in frame.groups()], abs=0.2
    )


def test_bars_are_read_by_their_names(tmp_path):
    figure = new_figure()
    axes = style(figure.add_subplot(), "", "zero (deg)")
    axes.bar(range(2), [1.5, -0.5], color=PALETTE["c1"])
    axes.set_xticks(range(2), ["FL", "BL"])
    (found,) = json.loads(taken_out(save_figure(figure, tmp_path / "b.svg").read_text())[1])["axes"]
    assert found["x"]["names"] == {"0": "FL", "1": "BL"}
    assert (found["series"][0]["x"], found["series"][0]["y"]) == ([0.0, 1.0], [1.5, -0.5])
    assert len(found["areas"]) == 2


def test_what_is_a_picture_only_is_not_enlarged(tmp_path):
    figure = new_figure()
    for k, draw in enumerate(
        (
            lambda a: a.imshow([[1.0, 2.0]]),
            lambda a: a.annotate("", (1, 1), (0, 0), arrowprops={}),
            lambda a: None,
        )
    ):
        axes = figure.add_subplot(1, 3, k + 1)
        axes.plot([0, 1], [0, 1], label="EKF")
        draw(axes)
    found = json.loads(taken_out(save_figure(figure, tmp_path / "c.svg").read_text())[1])["axes"]
    assert [axes.get("zoom", True) for axes in found] == [False, False, True]


@procedure(
    name="reported",
    measurements=(Measurement("end", "mm"),),
    headline=lambda v: f"It ends {v['end']} mm off.",
)
def reported(ctx):
    """Measure, or not."""
    if ctx.seed == 0:
        ctx.measure("end", 3.0)


@pytest.mark.parametrize(("seed", "words"), [(0, "It ends 3.0 mm off."), (1, "")])
def test_a_page_begins_with_what_its_procedure_says_of_the_values(tmp_path, seed, words):
    source = BenchSource(BenchConfig(schema=1, name="bare"), seed=seed)
    run_procedure(reported, source, RunOptions(tmp_path / "out", MonotonicClock(), "2026-01-01", {}))
    assert read_result(tmp_path / "out")["headline"] == words
    assert ('<p class="lead">It ends 3.0 mm off.' in write_run_page(tmp_path / "out").read_text()) == bool(
        words
    )


def test_many_measurements_stand_by_device_and_those_without_limit_apart():
    names = [
        "devices",
        "imu.rate",
        "imu.age",
        "steer_FL.zero",
        "drive_FL.way",
        *(f"servos.{k}" for k in range(5)),
    ]
    rows = [{"name": n, "outcome": "FAIL" if n == "imu.age" else "PASS"} for n in names]
    groups = {g["title"]: g for g in grouped(rows)}
    assert list(groups) == ["the run as a whole", "imu", "wheel FL", "servos"]
    assert groups["imu"]["counts"] == {"PASS": 1, "FAIL": 1}
    assert {title for title, g in groups.items() if g["bad"]} == {"imu"}
    assert [g["title"] for g in grouped(rows[:3])] == [""]


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
    [(None, "holds no result.json"), ("{", "is not JSON"), ('{"schema": 1}', "not the result")],
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
    tree["measurements"][2]["outcome"], tree["verdict"] = "PASS", "MARGINAL"
    tree["parameters"] = {"gain": 2}
    del tree["measurements"][3]
    (tmp_path / "result.json").write_text(json.dumps(tree))
    table = compare([folder, tmp_path])
    rows = {r["name"]: r for r in table["measurements"]}
    assert (rows["outside"]["change"], rows["outside"]["ratio"]) == (-1.0, 0.5 / 1.5)
    assert rows["outside"]["outcomes"] == ["FAIL", "PASS"]
    assert rows["reported"]["values"] == [12.0, None]
    assert table["differences"] == [{"key": "parameters.gain", "law": None, "values": ["–", "2"]}]
    assert "outside" in comparison_text(table)
    page = Page(write_compare_page(tmp_path / "compare.html", table).read_text())
    words = " ".join(page.text)
    assert "parameters.gain" in words
    assert "2 measurements have another outcome: outside, reported." in words


def test_runs_of_other_seeds_and_faults_are_not_the_same(folder, tmp_path):
    tree = json.loads((folder / "result.json").read_text())
    changed = {"seed": 7, "faults": ["imu:off@1", "tracker:off"]}
    (tmp_path / "result.json").write_text(json.dumps({**tree, **changed}))
    table = compare([folder, tmp_path])
    assert {row["key"]: row["values"][1] for row in table["differences"]} == {
        "seed": "7",
        "faults": "imu:off@1, tracker:off",
    }
    assert compare([tmp_path, tmp_path])["differences"] == []


def test_different_procedures_are_not_compared(folder, tmp_path):
    tree = json.loads((folder / "result.json").read_text()) | {"procedure": "other"}
    (tmp_path / "result.json").write_text(json.dumps(tree))
    with pytest.raises(UsageError, match="other, shown"):
        compare([folder, tmp_path])


def said_of(declared, values, headline=""):
    rows = judge(declared, values, {}, {}, {}, ended=True)
    return sentence({"error": None, "teardown_errors": [], "headline": headline, "measurements": rows})


def test_what_was_not_measured_after_a_failure_does_not_count_as_one():
    gap, more = Measurement("gap_width", "m", high=0.005), Measurement("after", "m", high=1.0)
    assert said_of([gap, more], {"gap_width": 0.006}) == (
        "1 of 2 limits failed: gap width 6 mm, at most 5 mm. What comes after that was not measured: after."
    )


@pytest.mark.parametrize("value", [1.0000001, 0.9999999])
def test_a_value_never_reads_like_a_limit_that_it_is_not(tmp_path, value):
    @procedure(name="near", measurements=(Measurement("b/c", "mm", high=1.0),))
    def near(ctx):
        """A hair beside its limit."""
        ctx.measure("b/c", value)

    source = BenchSource(BenchConfig(schema=1, name="bare"))
    options = RunOptions(tmp_path / "run", MonotonicClock(), "2026-01-01", {})
    result = run_procedure(near, source, options)
    outcome = "FAIL" if value > 1.0 else "PASS"
    assert text_of(result).splitlines()[0].split() == [outcome, "b/c", str(value), "mm", "<=", "1"]
    assert f"<td>{value}</td>" in write_run_page(tmp_path / "run").read_text()
    failures = (tmp_path / "run" / "junit.xml").read_text().count(f"{value} mm, expected &lt;= 1 mm")
    assert failures == (outcome == "FAIL")


def test_a_headline_has_no_values_that_are_no_numbers(tmp_path):
    @procedure(
        name="nan", measurements=(Measurement("end", "mm"),), headline=lambda v: f"Ends {v['end']} off."
    )
    def nan(ctx):
        """Measures no number."""
        ctx.measure("end", float("nan"))

    source = BenchSource(BenchConfig(schema=1, name="bare"))
    run_procedure(nan, source, RunOptions(tmp_path / "out", MonotonicClock(), "2026-01-01", {}))
    assert read_result(tmp_path / "out")["headline"] == ""
