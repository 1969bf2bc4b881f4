"""What README and guides print works as printed: links, commands, and every example."""

import importlib
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import hil
from hil.bench import make_bench_model
from hil.cli import main
from hil.recording.mcap_writer import McapRecorder
from hil.robot import trajectories
from hil.user_code.roles import CONTROLLER

pytestmark = pytest.mark.usefixtures("warm_commands")

ROOT = Path(__file__).resolve().parents[2]
ABOUT = [page for page in ROOT.glob("*.md") if page.name != "CHANGELOG.md"]
GUIDES = [page for folder in ("docs", "examples") for page in (ROOT / folder).glob("*.md")]
PAGES = sorted([*ABOUT, *GUIDES, *(ROOT / "firmware").rglob("*.md")])
README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "add-your-own-device.md").read_text(encoding="utf-8")


def blocks(text, language):
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_and_pictures_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    missing = [t for t in targets if "://" not in t and not (page.parent / t).exists()]
    assert missing == []


def test_the_references_are_current_and_all_that_is_on_them_is_explained():
    names = ("bench", "fault", "python", "command")
    scripts = [str(ROOT / "docs" / f"make_{name}_reference.py") for name in names]
    code = f"import runpy; print(*(runpy.run_path(s)['page']() for s in {scripts}), sep='\\0', end='')"
    pages = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    keys, now, python, commands = pages.split("\0")
    assert (ROOT / "docs" / "api.md").read_text(encoding="utf-8") == python
    assert (ROOT / "docs" / "commands.md").read_text(encoding="utf-8") == commands
    assert (ROOT / "docs" / "bench-file.md").read_text(encoding="utf-8") == keys
    assert re.findall(r"\| `(\w+)` \| [^|]* \| [^|]* \|  \|", keys) == []
    assert (ROOT / "docs" / "faults.md").read_text(encoding="utf-8") == now
    explained, _, devices = now.partition("## Options")[2].partition("## Devices")
    taken = {o for group in re.findall(r"\(([^)]*)\)", devices) for o in re.findall(r"`(\w+)", group)}
    assert taken == set(re.findall(r"^\| `(\w+)`(?: of `\w+`)? \|", explained, re.MULTILINE))


def test_the_picture_of_the_rooms_shows_the_imports_of_today():
    script = runpy.run_path(str(ROOT / "docs" / "make_architecture.py"))
    drawn = script["drawn"](script["PICTURE"].read_text())
    assert drawn == script["reduced"](script["imports"](script["rooms_of"]())), "run make docs"
    assert len(drawn) > 20


def python_block(containing):
    found = [b for b in blocks(README, "python") if containing in b]
    assert len(found) == 1
    return found[0]


def run(*command, cwd):
    done = subprocess.run([sys.executable, *command], cwd=cwd, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_ten_line_procedure_runs_as_printed(tmp_path, monkeypatch, capsys):
    block = python_block("@procedure")
    assert len([line for line in block.splitlines() if line.strip()]) <= 10
    (tmp_path / "short_line.py").write_text(block)
    monkeypatch.chdir(tmp_path)
    assert main(["run", "short_line.py"]) == 0
    assert "PASS: short_line" in capsys.readouterr().out
    assert list(tmp_path.glob("out/short_line/*/report.html"))


def test_the_script_runs_as_printed(tmp_path, monkeypatch, capsys):
    (tmp_path / "script.py").write_text(python_block("open_bench"))
    monkeypatch.chdir(tmp_path)
    runpy.run_path("script.py", run_name="__main__")
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["truth", "EKF", "odometry"]


def test_every_test_runs_as_printed(tmp_path):
    shown = blocks((ROOT / "docs" / "pytest.md").read_text(encoding="utf-8"), "python")
    named = {name: [b for b in shown if f"def test_my_{name}(" in b] for name in ("controller", "estimator")}
    for name, (block,) in {**named, "bench": [python_block("pytest.mark.fault")]}.items():
        (tmp_path / f"test_{name}.py").write_text(block)
    named_on_a_line = f"{tmp_path / 'test_controller.py'}:FeedForward"
    CONTROLLER.check(named_on_a_line)
    assert 0.02 < CONTROLLER.make(named_on_a_line, make_bench_model("emulated")).radius_m < 0.03
    reported = run("-m", "pytest", "-q", cwd=tmp_path)
    assert "3 passed" in reported
    assert "NOT HELD" not in reported


def test_a_comparison_of_an_estimator_of_ones_own_runs_as_printed(tmp_path):
    pages = [(ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in ("pytest", "estimation")]
    (mine,) = [b for b in blocks(pages[0], "python") if "class MotionCapture" in b]
    (compared,) = [b for b in blocks(pages[1], "python") if "import compare" in b]
    (tmp_path / "mine.py").write_text(mine)
    with hil.open_bench("emulated_floor") as bench:
        bench.add_sink(McapRecorder(tmp_path / "recording.mcap", bench.header(), lossless=True))
        bench.drive(trajectories.line((0, 0, 0), (0.02, 0, 0), duration_s=1.0))
    (tmp_path / "compared.py").write_text(compared)
    rows = [row.split() for row in run("compared.py", cwd=tmp_path).splitlines()]
    assert [row[0] for row in rows] == ["recorded", "mine"]
    assert all(0.0 < float(row[1]) < 0.005 for row in rows)
    (command,) = [b for b in blocks(pages[1], "sh") if "mine.py:" in b]
    program, *words = command.split()
    assert program == "hil"
    rows = [row.split() for row in run("-m", "hil", *words, cwd=tmp_path).splitlines()]
    assert [row[0] for row in rows[1:4]] == ["recorded", "ekf", "mine.py:MotionCapture"]


COPIED = (
    ROOT / "docs" / "ci-template",
    *(ROOT / "examples" / name for name in ("rangefinder", "ros2", "ros2/ci")),
)
"""Folders to start from; what a page says of their files is relative to them."""

OF_A_USER = {
    "path/to/mine.py",
    "data/odom_11.csv",
    *re.findall(r"^`(my-\w+/[\w.]+)`", GUIDE, re.M),
    "docs/index.html",  # of the site, once `make site` has built it
}
FILE = re.compile(
    r"(?<![\w/.:<-])([\w-]+/[\w./-]*\.(?:md|py|toml|json|csv|dbc|png|svg|html|mcap|lock|yml|sh))\b"
)


def test_no_text_cites_a_file_that_the_project_does_not_have():
    """Docstrings end up on report pages and in the reference; what they cite must be there to be read."""
    folders = [ROOT / name for name in ("hil", "procedures", "docs", "examples")]
    paths = [ROOT / "README.md", *(p for folder in folders for p in folder.rglob("*"))]
    missing = []
    for path in paths:
        if path.suffix not in (".py", ".md", ".toml", ".html", ".yml"):
            continue
        bases = (ROOT, ROOT / "hil", *COPIED, path.parent)
        cited = set(FILE.findall(path.read_text(encoding="utf-8"))) - OF_A_USER
        outputs = ("out/", "dist/", "wheels/", "results/", "docs/index.html", "KIND/")
        missing += [
            f"{path.relative_to(ROOT)}: {name}"
            for name in cited
            if not name.startswith(outputs)
            and "/KIND/" not in name
            and not any((base / name).exists() for base in bases)
        ]
        missing += [f"{path.relative_to(ROOT)}: ../" for _ in re.findall(r"\.\./shared\b", path.read_text())]
    assert missing == []


NAME = re.compile(r"(?<![\w./-])hil(?:\.[A-Za-z_]\w*)+")
NAMES_OF_BEFORE = {"hil.signals", "hil.devices"}
"""What a decision on moving it has to call by its old name; the group of entry points."""


def is_there(dotted):
    """Whether a dotted name is a module, or something in one."""
    parts = dotted.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] != "hil":
                return True  # it needs a library that is not for this Python; others look at it
            continue
        for name in parts[cut:]:
            found = getattr(found, name, None)
        return found is not None
    return False


def test_every_module_that_a_text_names_is_where_it_says():
    """Pages and docstrings: a module that moved is named by its new place everywhere."""
    sources = [*(ROOT / "hil").rglob("*.py"), *(ROOT / "procedures").rglob("*.py")]
    named = {
        (name, str(path.relative_to(ROOT)))
        for path in [*PAGES, *(ROOT / "docs" / "decisions").glob("*.md"), *sources]
        for name in NAME.findall(path.read_text(encoding="utf-8"))
    }
    assert len(named) > 100
    known = {name: is_there(name) for name in {name for name, _ in named} - NAMES_OF_BEFORE}
    assert sorted((path, name) for name, path in named if not known.get(name, True)) == []


def test_the_table_of_public_modules_names_what_is_in_each():
    """Every name in backticks is in its row's module, on the context (`ctx.`), or a shipped procedure."""
    text = (ROOT / "docs" / "procedures.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(hil\.[\w.]+)` \| (.+) \|$", text, re.MULTILINE)
    shipped = {path.stem for path in (ROOT / "procedures").glob("[a-z]*.py")}
    named = [(module, name) for module, said in rows for name in re.findall(r"`([\w.]+)`", said)]
    assert len(rows) >= 7
    assert len(named) > len(rows)
    places = [
        name.replace("ctx.", "hil.procedure.Context.") if name.startswith("ctx.") else f"{module}.{name}"
        for module, name in named
        if name not in shipped
    ]
    assert [place for place in places if not is_there(place)] == []
