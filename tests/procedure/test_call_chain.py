"""An exception in the user's own code is reported with the calls in that code that led to it, no others."""

import json
import pickle
import sys
from xml.etree import ElementTree

import pytest

from hil.cli import main
from hil.core.call_chain import chain_of, keep_chain

BOOM = """
from hil.procedure import Measurement, procedure
import measuring

@procedure(name="boom", needs=("servos",), measurements=[Measurement("value", "m", high=1.0)])
def run(ctx):
    with ctx.step("a step"):
        ctx.checkpoint("a checkpoint", lambda: middle(ctx))

def middle(ctx):
    {call}
"""
MEASURING = """
import json

from hil.recording.runs import RunStart
from hil.robot.trajectories import line

class Follows:
    def reset(self):
        pass

    def update(self, state, reference, wheels):
        return 1.0 / 0

def deep(ctx):
    return json.loads("nonsense")

def chained(ctx):
    try:
        deep(ctx)
    except ValueError as error:
        raise KeyError("lost") from error

def steered(ctx):
    bench = ctx.bench
    way = line(bench.start_state().pose_body_in_wall, [0.1, 0, 0], duration_s=3)
    pipeline = bench.make_pipeline(way)
    pipeline.controller = Follows()
    bench.devices.actuators().enable()
    start = RunStart(bench.start_state(bench.settle()), "ekf", trajectory=way.to_mapping())
    bench.run(pipeline, start, lambda record: False)
"""
CASES = {
    "an exception": ("deep", ["run", "<lambda>", "middle", "deep"], "JSONDecodeError"),
    "one from another": ("chained", ["run", "<lambda>", "middle", "chained", "chained", "deep"], "KeyError"),
    "a controller": ("steered", ["run", "<lambda>", "middle", "steered", "update"], "ZeroDivisionError"),
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "measuring", raising=False)
    (tmp_path / "measuring.py").write_text(MEASURING)
    yield tmp_path
    for name in ("measuring", "beside", "later"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("case", CASES)
def test_the_calls_of_a_procedure_are_reported_everywhere(case, here, capsys):
    name, functions, kind = CASES[case]
    (here / "boom.py").write_text(BOOM.format(call=f"measuring.{name}(ctx)"))
    assert main(["run", "boom.py", "--out", "out", "--json"]) == 2
    said = capsys.readouterr()
    frames = json.loads(said.out)["error"]["frames"]
    assert [frame["function"] for frame in frames] == functions
    assert {frame["file"] for frame in frames} == {"boom.py", "measuring.py"}
    for frame in frames:
        assert (here / frame["file"]).read_text().splitlines()[frame["line"] - 1].strip() == frame["code"]
    kept = json.loads((here / "out" / "result.json").read_text())["error"]
    assert (kept["frames"], kept["type"]) == (frames, kind)
    (error,) = ElementTree.parse(here / "out" / "junit.xml").iter("error")
    page = (here / "out" / "report.html").read_text().replace("&#34;", '"')
    for frame in frames:
        place = f'File "{frame["file"]}", line {frame["line"]}, in {frame["function"]}'
        assert place in said.err
        assert place in error.text
        folded = page[page.index("<details") : page.index("</details>")]
        assert place.replace("<", "&lt;").replace(">", "&gt;") in folded
    assert "hil/" not in said.err


WRONG_SCRIPTS = {
    "at its import": "import measuring\nmeasuring.deep(None)\n",
    "a declaration": (
        "import measuring\nfrom hil.procedure import procedure\n"
        "@procedure(name='boom', measurements=measuring.deep)\ndef run(ctx): ...\n"
    ),
}


@pytest.mark.parametrize("case", WRONG_SCRIPTS)
def test_the_calls_of_a_script_are_reported_before_anything_runs(case, here, capsys):
    (here / "boom.py").write_text(WRONG_SCRIPTS[case])
    assert main(["run", "boom.py", "--json"]) == 2
    said = capsys.readouterr()
    error = json.loads(said.out)["error"]
    assert error["frames"][-1]["file"] == "measuring.py"
    assert error["frames"][-1]["code"] == 'return json.loads("nonsense")'
    assert "measuring.py" in error["message"]
    assert 'File "measuring.py", line' in said.err
    assert "hil/" not in said.err


def test_a_call_that_calls_itself_is_reported_once(here, capsys):
    (here / "boom.py").write_text("def again(n):\n    return again(n + 1)\n\nagain(0)\n")
    assert main(["run", "boom.py", "--json"]) == 2
    frames = json.loads(capsys.readouterr().out)["error"]["frames"]
    assert [(frame["line"], frame["times"] > 100) for frame in frames] == [(4, False), (2, True)]


@pytest.mark.parametrize("traceback_sent", [False, True])
def test_what_comes_from_another_process_keeps_its_calls(here, traceback_sent):
    """Libraries such as tblib send traceback and cause, too."""
    sys.path.insert(0, str(here))
    sys.modules.pop("measuring", None)  # of another test's folder
    import measuring

    try:
        measuring.chained(None)
    except KeyError as error:
        keep_chain(error)
        sent = pickle.loads(pickle.dumps(error)).with_traceback(
            error.__traceback__ if traceback_sent else None
        )
        sent.__cause__ = error.__cause__ if traceback_sent else None
    functions = [frame.function for frame in chain_of(sent)]
    assert functions[1:] == ["chained", "chained", "deep"]


def test_a_module_beside_a_script_is_found_from_any_folder(here, monkeypatch, capsys):
    """As Python and pytest find it, from elsewhere; no folder that is looked through is the current one."""
    (here / "boom.py").write_text("from beside import procedure_of_mine\n")
    (here / "beside.py").write_text(
        "from hil.procedure import procedure\n\n"
        "@procedure(name='boom')\ndef procedure_of_mine(ctx):\n    import later\n    ctx.note(later.WORD)\n"
    )
    (here / "later.py").write_text("WORD = 'found'\n")
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    assert main(["run", "../boom.py", "--out", "out", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == ["found"]
