"""What invites others: a picture of the code as it is, steps still open, forms that ask for what helps."""

import importlib.util
import json
import re
import tempfile
from datetime import date
from pathlib import Path

import click
import pytest

from hil.report.figures import save_figure
from hil.report.readings import taken_out
from hil.report.run_plots import new_figure

yaml = pytest.importorskip("yaml", reason="needs PyYAML to read the forms")

ROOT = Path(__file__).resolve().parents[2]
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def architecture():
    spec = importlib.util.spec_from_file_location("make_architecture", ROOT / "docs" / "make_architecture.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_picture_of_the_rooms_shows_the_imports_of_today(architecture):
    rooms = architecture.rooms_of()
    now, drawn = architecture.imports(rooms), architecture.drawn(architecture.PICTURE.read_text())
    assert drawn == architecture.reduced(now), "run make docs"
    assert architecture.PICTURE.read_text() == architecture.svg(rooms, drawn)
    assert len(now) > len(drawn) > 20


def test_make_docs_writes_afresh_what_tests_compare_to_the_letter():
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("\ndocs: ")[1].split("\n\n")[0]
    scripts = set(re.findall(r"docs/(make_\w+\.py)", recipe))
    assert scripts == {"make_bench_reference.py", "make_fault_reference.py", "make_architecture.py"}


def test_what_follows_from_two_arrows_is_left_out(architecture):
    assert architecture.reduced({("a", "b"), ("b", "c"), ("a", "c"), ("a", "d")}) == {
        ("a", "b"),
        ("b", "c"),
        ("a", "d"),
    }


def test_every_arrow_points_down_and_no_box_lies_on_another(architecture):
    places = {room: architecture.PLACES.get(room, architecture.NEW) for room in architecture.rooms_of()}
    for above, below in architecture.drawn(architecture.PICTURE.read_text()):
        assert places[above][1] < places[below][1], (above, below)
    wide = architecture.BOX / architecture.COLUMN
    tall = architecture.TALL / architecture.ROW
    boxes = list(places.items())
    for k, (room, (x, y)) in enumerate(boxes):
        for other, (u, v) in boxes[k + 1 :]:
            assert abs(x - u) >= wide or abs(y - v) >= tall, (room, other)


def quick_scan():
    from hil.procedure.scripts import load_procedure

    assert load_procedure("wall_ablation").quick
    return not load_procedure("grid_scan").quick


def export_to_mat():
    from hil.cli.export import command

    (option,) = (p for p in command.params if "--format" in p.opts)
    assert isinstance(option.type, click.Choice)
    return "mat" not in option.type.choices


def arrows_on_a_page():
    figure = new_figure()
    figure.add_subplot().annotate("", (1.0, 1.0), (0.0, 0.0), arrowprops={"arrowstyle": "-|>"})
    with tempfile.TemporaryDirectory() as folder:
        readings = taken_out(save_figure(figure, Path(folder) / "a.svg").read_text())[1]
    return readings == "" or json.loads(readings)["axes"] == []


def other_motion_capture():
    from hil.vocabulary.kinds import kinds

    return [m.name for m in kinds()["mocap"].models] == ["natnet"]


OPEN = {
    "a quick form of `grid_scan`": quick_scan,
    "recordings for MATLAB and Octave": export_to_mat,
    "arrows that can be read off a page": arrows_on_a_page,
    "motion capture by another maker": other_motion_capture,
}


def test_the_list_of_first_steps_is_the_one_that_is_checked():
    listed = CONTRIBUTING.split("## First steps that are wanted")[1]
    rows = re.findall(r"^\| (?!step |--)([^|]+?) \|", listed, re.M)
    assert len(rows) == len(OPEN)
    assert all(row.startswith(step) for row, step in zip(rows, OPEN, strict=True))


@pytest.mark.parametrize("step", OPEN)
def test_a_first_step_is_still_open(step):
    assert OPEN[step](), f"{step}: done; take it off the list in CONTRIBUTING.md, and off this one"


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.stem)
def test_a_form_is_complete(form):
    tree = yaml.safe_load(form.read_text(encoding="utf-8"))
    assert {"name", "description", "labels", "body"} <= set(tree)
    asked = [item for item in tree["body"] if item["type"] != "markdown"]
    assert {item["type"] for item in asked} <= {"textarea", "input", "dropdown", "checkboxes"}
    assert len({item["id"] for item in asked}) == len(asked)
    assert all(item["attributes"]["label"] and "required" in item["validations"] for item in asked)
    assert any(item["validations"]["required"] for item in asked)


def test_the_form_of_a_fault_asks_for_what_contributing_names():
    (form,) = (f for f in FORMS if f.stem == "fault")
    ids = {item["id"] for item in yaml.safe_load(form.read_text())["body"] if "id" in item}
    assert {"command", "expected", "happened", "info"} <= ids
    assert "Give the command, what you expected, what happened, and the output of `hil info`" in CONTRIBUTING


def test_the_citation_is_complete_and_cites_the_paper_of_the_robot():
    assert {"cff-version", "message", "title", "authors", "version", "license", "type"} <= set(CITATION)
    (paper,) = CITATION["references"]
    assert "arXiv:2509.04016" in str(paper["identifiers"])
    assert paper["title"] in (ROOT / "README.md").read_text().replace("\n", " ")
    released = CITATION.get("date-released")
    assert released is None or isinstance(released, date)


def test_the_code_of_conduct_says_what_is_asked_what_is_not_borne_and_whom_to_tell():
    text = (ROOT / "CODE_OF_CONDUCT.md").read_text(encoding="utf-8").lower()
    missing = [
        word for word in ("be kind", "harassment", "maintainer", "private", "exclude") if word not in text
    ]
    assert missing == []
