"""What a procedure leaves is in its results: nothing written over, nothing lost to a value or a character."""

import json
import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hil.cli import main
from hil.cli.run import text_of
from hil.config.bench import bench_model
from hil.procedure import BenchSource, Measurement, procedure
from hil.report.run_page import write_run_page

ONE = (Measurement("a", "mm", high=1.0),)


def result_of(result):
    return json.loads((result.folder / "result.json").read_text())


def test_attachments_of_one_name_are_kept_each(run_small, tmp_path):
    contents = ["first", "second", "third", "first"]
    paths = []
    for number, content in enumerate(contents):
        path = tmp_path / str(number) / "data.csv"
        path.parent.mkdir()
        path.write_text(content)
        paths.append(path)

    @procedure(name="leaver")
    def leaver(ctx):
        for path, content in zip(paths, contents, strict=True):
            assert ctx.attach(f"data {path.parent.name}", path).read_text() == content
            path.unlink()

    result = run_small(leaver)
    left = result_of(result)["attachments"]
    assert [(result.folder / item["path"]).read_text() for item in left] == contents
    names = [Path(item["path"]).name for item in left]
    assert names == ["data.csv", "data-2.csv", "data-3.csv", "data.csv"]


def test_numbers_and_arrays_of_numpy_are_left_as_plain_ones(run_small):
    @procedure(name="numeric")
    def numeric(ctx):
        ctx.leave_data("rows", np.arange(6).reshape(2, 3))
        ctx.leave_data(
            "facts", {"count": np.int64(3), "held": np.bool_(True), "pair": (np.float32(0.5), None)}
        )

    result = run_small(numeric)
    assert result.exit_code == 0
    assert result_of(result)["data"] == {
        "rows": [[0, 1, 2], [3, 4, 5]],
        "facts": {"count": 3, "held": True, "pair": [0.5, None]},
    }


@pytest.mark.parametrize("wrong", [Path("/x"), {1, 2}, {("a", 1): 2}, np.array([Path("/x")]), 1 + 2j])
def test_data_that_json_cannot_hold_is_named_and_costs_no_results(run_small, wrong):
    @procedure(name="opaque", measurements=ONE)
    def opaque(ctx):
        ctx.measure("a", 0.5)
        ctx.leave_data("good", 1)
        ctx.leave_data("bad", {"inner": [wrong]})

    result = run_small(opaque)
    assert result.exit_code == 2
    assert result.error.message.startswith("data 'bad' is what JSON cannot hold (")
    tree = result_of(result)
    assert (tree["data"], tree["measurements"][0]["outcome"]) == ({"good": 1}, "PASS")


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (os.fsdecode(b"/data/\xff.csv"), r"/data/\udcff.csv"),
        ("bell \x1b[31mred\x00 \ufffe end", r"bell \x1b[31mred\x00 \ufffe end"),
    ],
)
def test_an_exception_of_any_characters_keeps_all_results(run_small, text, reported):
    @procedure(name="speaking", measurements=(*ONE, Measurement(text, "1")))
    def speaking(ctx):
        ctx.measure("a", 0.5)
        ctx.note(text)
        ctx.table(text, [text], [[text]])
        raise FileNotFoundError(text)

    result = run_small(speaking)
    assert result.teardown_errors == ()
    assert result_of(result)["error"]["message"].startswith(text)
    suite = ElementTree.parse(result.folder / "junit.xml").getroot()
    assert next(suite.iter("error")).get("message").startswith(reported)
    assert [case.get("name") for case in suite.iter("testcase")] == ["run", "a", reported]
    said = text_of(result)
    assert f"FileNotFoundError in 'start': {reported}" in said
    assert f"note: {reported}" in said
    assert write_run_page(result.folder).read_text()


@pytest.mark.parametrize(
    ("values", "verdict", "note"),
    [
        ([99, 0.5], "PASS", "a was set 2 times: 99 mm (FAIL), 0.5 mm (PASS). The last one counts."),
        ([0.5, 0.5], "PASS", ""),
    ],
)
def test_a_measurement_that_is_set_again_is_reported(run_small, values, verdict, note):
    @procedure(name="again", measurements=ONE)
    def again(ctx):
        for value in values:
            ctx.measure("a", value)

    result = run_small(again)
    tree = result_of(result)
    assert (tree["verdict"], tree["measurements"][0]["value"]) == (verdict, values[-1])
    assert tree["measurements"][0].get("earlier", []) == (values[:-1] if note else [])
    assert tree["notes"] == ([note] if note else [])
    assert text_of(result).count("\nnote: ") == bool(note)
    assert f"\nnote: {note}" in text_of(result) or not note
    assert "The last one counts." in write_run_page(result.folder).read_text() or not note


@pytest.mark.parametrize(
    ("leave", "reported"),
    [
        (
            lambda ctx: ctx.table("t", ["a", "b"], [[1, 2], [1, 2, 3]]),
            "table 't': row 2 has 3 cells; expected 2",
        ),
        (lambda ctx: [ctx.table("t", ["a"], [[k]]) for k in range(2)], "table 't' exists twice"),
        (lambda ctx: ctx.figure(lambda: 5, "f"), "figure 'f' is a int; expected a matplotlib Figure"),
        (lambda ctx: [ctx.figure(drawn, "f") for _ in range(2)], "figure 'f' exists twice"),
    ],
)
def test_a_table_or_figure_that_cannot_be_meant_is_reported_by_its_title(run_small, leave, reported):
    @procedure(name="wrong", measurements=ONE)
    def wrong(ctx):
        ctx.measure("a", 0.5)
        leave(ctx)

    result = run_small(wrong)
    assert (result.error.kind, result.exit_code) == ("UsageError", 2)
    assert result.error.message.startswith(reported)
    assert result.measurements[0]["outcome"] == "PASS"


@pytest.mark.parametrize("keep", ["all", "results"])
def test_a_figure_that_exists_twice_is_refused_whether_drawn_or_not(run_small, keep):
    @procedure(name="wrong")
    def wrong(ctx):
        for _ in range(2):
            ctx.figure(drawn, "f")

    result = run_small(wrong, keep=keep)
    assert result.exit_code == 2
    assert result.error.message.startswith("figure 'f' exists twice")


def test_a_headline_that_fails_costs_no_results(caplog):
    broken = procedure(name="broken", headline=lambda values: 1 / 0)(lambda ctx: None)
    assert broken.said({}) == ""
    assert "the headline of broken failed (ZeroDivisionError" in caplog.text


def drawn():
    from matplotlib.figure import Figure

    return Figure()


def test_a_page_and_ci_say_how_to_repeat_a_run_and_where_the_real_devices_were(run_small, tmp_path):
    @procedure(name="idle", measurements=())
    def idle(ctx):
        ctx.note("a note of a run that passes")

    config = bench_model().model_validate({"schema": 1, "name": "lab", "imu": {"port": "/dev/ttyUSB7"}})
    result = run_small(idle, source=BenchSource(config), command="hil run idle --set 'x=[1, 2]'")
    assert result_of(result)["real"] == {"imu": "/dev/ttyUSB7"}
    suite = ElementTree.parse(result.folder / "junit.xml").getroot()
    said = {p.get("name"): p.get("value") for p in suite.iter("property")}
    assert said["real.imu"] == "/dev/ttyUSB7"
    page = write_run_page(result.folder).read_text()
    assert "hil run idle --set &#39;x=[1, 2]&#39;" in page
    assert "imu at /dev/ttyUSB7" in page
    assert "note: a note of a run that passes" in text_of(result)


def test_the_command_that_repeats_a_run_leaves_out_where_its_results_go(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my run.py").write_text(
        "from hil.procedure import procedure\n\n\n@procedure(name='r', measurements=())\n"
        "def run(ctx):\n    '''Nothing.'''\n"
    )
    words = ["--out", "here", "--seed", "3", "--answers=x.txt", "--json"]
    (tmp_path / "x.txt").write_text("")
    assert main(["run", "my run.py", *words]) == 0
    assert json.loads((tmp_path / "here" / "result.json").read_text())["command"] == (
        "hil run 'my run.py' --seed 3"
    )
