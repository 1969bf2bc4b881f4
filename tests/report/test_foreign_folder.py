"""A results folder from elsewhere: its page runs nothing, loads nothing and leads nowhere else."""

import base64
import hashlib
import html
import http.server
import json
import re
import shutil
import subprocess
import threading
from html.parser import HTMLParser
from importlib.resources import files
from urllib.parse import unquote

import pytest

from hil.cli import main
from hil.core.errors import DataError
from hil.report.result_reader import read_result
from hil.report.run_page import write_run_page

EVIL = '"><script>document.title = "ran"</script><img src="http://127.0.0.1:{port}/text" onerror="alert(1)">'
SVG = """<?xml version="1.0"?>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"
 width="200pt" height="100pt"
 viewBox="0 0 200 100" onload="document.title = 'ran'">
<script>document.title = "ran"; fetch("http://127.0.0.1:{port}/fetch")</script>
<style>@import url("http://127.0.0.1:{port}/style");</style>
<image xlink:href="http://127.0.0.1:{port}/image" width="20" height="20"/>
<foreignObject width="20" height="20"><iframe xmlns="http://www.w3.org/1999/xhtml" src="http://127.0.0.1:{port}/f"/>
</foreignObject>
<a xlink:href="javascript:document.title='ran'"><rect width="200" height="100" style="fill: #2563ea"/></a>
</svg>"""


def tree(evil):
    return {
        "schema": 1,
        "procedure": f"p{evil}",
        "verdict": "ERROR",
        "summary": evil,
        "bench": evil,
        "started": evil,
        "seed": 1,
        "faults": [evil],
        "emulated": [evil],
        "git_revision": evil,
        "held": {"state": evil, "moved_m": 0.001, "why": evil, "by": evil, "rests_on": [evil]},
        "error": {"type": evil, "message": evil, "step": evil},
        "teardown_errors": [{"type": evil, "message": evil, "step": evil}],
        "measurements": [
            {
                "name": evil,
                "unit": evil,
                "value": 1.0,
                "low": 0.0,
                "high": 2.0,
                "margin": 1.0,
                "outcome": "PASS",
                "limited": True,
                "rationale": evil,
            }
        ],
        "steps": [{"title": evil, "outcome": evil, "depth": 1, "bench_s": 1.0, "wall_s": 1.0}],
        "tables": [{"title": evil, "head": [evil], "rows": [[evil]], "note": evil}],
        "figures": [{"title": evil, "caption": evil, "path": "figures/evil.svg"}],
        "attachments": [{"name": evil, "path": evil}],
        "recordings": [evil],
        "notes": [evil],
        "parameters": {evil: evil},
        "config": {evil: [evil]},
        "versions": {evil: evil},
        "loop": {evil: evil},
        "calibration": {"path": evil, "version": evil, "sha256": evil},
    }


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.images, self.handlers = set(), [], [], []
        self.scripts = []
        self.feed(text)

    def handle_data(self, data):
        if self.lasttag == "script" and data.strip():
            self.scripts.append(data)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        found = dict(attrs)
        self.links += [found["href"]] if "href" in found else []
        self.images += [found["src"]] if "src" in found else []
        self.handlers += [name for name in found if name.startswith("on")]


def hostile(tmp_path, port=1):
    """A results folder in which everything is hostile."""
    out = tmp_path / "elsewhere"
    (out / "figures").mkdir(parents=True)
    (out / "result.json").write_text(json.dumps(tree(EVIL.format(port=port))))
    (out / "figures" / "evil.svg").write_text(SVG.format(port=port))
    return out


@pytest.fixture
def folder(tmp_path):
    return hostile(tmp_path)


@pytest.fixture
def served(tmp_path):
    """Such a folder, and the names of what it asks a server for."""
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_error(404)

        def log_message(self, *args):
            pass

    server = http.server.HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield hostile(tmp_path, server.server_address[1]), asked
    server.shutdown()
    server.server_close()
    thread.join()


def change(folder, **values):
    path = folder / "result.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_text_and_figures_of_a_foreign_folder_stay_text_and_pictures(folder):
    text = write_run_page(folder).read_text()
    page = Page(text)
    assert not page.tags & {"svg", "iframe", "object", "embed", "foreignobject", "base", "form"}
    assert not page.handlers
    assert len(page.images) == 1
    assert page.images[0].startswith("data:image/svg+xml;base64,")
    policy = re.search(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
    assert "default-src 'none'" in policy
    (script,) = page.scripts
    assert script == files("hil.report").joinpath("templates/figure.js").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert re.search(r"script-src ([^;]*);", policy)[1] == f"'sha256-{digest}'"


READINGS = {
    "size": [100.0, 50.0],
    "axes": [
        {
            "box": [0.0, 0.0, 90.0, 40.0],
            "x": {"label": "t", "limits": [0.0, 1.0]},
            "y": {"label": "v", "limits": [0.0, 1.0]},
            "series": [{"name": EVIL, "colour": "c1", "x": [0.0, 1.0], "y": [0.0, None]}],
        }
    ],
}


def with_readings(folder, readings):
    text = readings if isinstance(readings, str) else html.escape(json.dumps(readings))
    svg = f'<svg width="100pt"><metadata id="readings">{text}</metadata></svg>'
    (folder / "figures" / "evil.svg").write_text(svg)
    return re.search(r'data-readings="([^"]*)"', write_run_page(folder).read_text())


def test_readings_of_a_foreign_figure_are_numbers_and_names(folder):
    kept = with_readings(folder, READINGS)
    assert json.loads(html.unescape(kept[1]))["axes"][0]["series"][0]["name"] == EVIL
    assert "<" not in kept[1]


@pytest.mark.parametrize(
    "change",
    [
        {"colour": "url(http://127.0.0.1/x)"},
        {"x": ["1", "2"]},
        {"onload": "alert(1)"},
        {"y": [0.0] * 5000},
        {"width": "3;x"},
    ],
)
def test_readings_that_are_not_sound_are_left_out(folder, change):
    axes = READINGS["axes"][0]
    wrong = {**READINGS, "axes": [{**axes, "series": [axes["series"][0] | change]}]}
    assert with_readings(folder, wrong) is None
    assert with_readings(folder, "{no json") is None


@pytest.mark.parametrize("path", ["javascript:alert(1)", "//example.org/x", "a b&c.mcap"])
def test_links_of_a_foreign_folder_are_files_in_it(folder, path):
    change(folder, attachments=[{"name": "x", "path": path}], recordings=[path])
    links = Page(write_run_page(folder).read_text()).links
    assert all(not re.match(r"[a-zA-Z][a-zA-Z0-9+.-]*:|/", link) for link in links)
    assert {unquote(link) for link in links} <= {path}


@pytest.mark.parametrize("path", ["../../secret.txt", "/etc/passwd", "link.txt", "\0"])
def test_what_lies_outside_a_foreign_folder_is_no_link_and_no_figure(folder, path, tmp_path):
    (tmp_path / "secret.txt").write_text("<svg></svg>")
    (folder / "link.txt").symlink_to(tmp_path / "secret.txt")
    change(folder, attachments=[{"name": "x", "path": path}], recordings=[path])
    text = write_run_page(folder).read_text()
    assert Page(text).links == []
    assert text.count("outside this folder") == 2
    change(folder, figures=[{"title": "t", "path": path}])
    with pytest.raises(DataError, match="outside its folder"):
        write_run_page(folder)


def test_the_page_is_not_written_through_a_link(folder, tmp_path, capsys):
    mine = tmp_path / "mine.txt"
    mine.write_text("keep")
    (folder / "report.html").symlink_to(mine)
    (folder / "compare.html").symlink_to(mine)
    for folders in ([str(folder)], [str(folder)] * 2):
        assert main(["report", *folders]) == 2
        assert "is a symbolic link" in capsys.readouterr().err
    assert mine.read_text() == "keep"


def test_no_control_character_of_a_foreign_folder_reaches_the_terminal(folder, capsys):
    row = {"name": "a\x1b]0;title\x07\ud800", "unit": "1", "value": 3.0, "high": 2.0, "outcome": "PASS"}
    change(folder, measurements=[row])
    assert main(["report", str(folder)]) == 2
    said = capsys.readouterr().err
    assert r"a\x1b]0;title\x07\ud800 is PASS with a value beyond its limit" in said
    assert "\x1b" not in said


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("measurements", [{"name": 1}]),
        ("steps", [{"title": "a", "depth": "0;x"}]),
        ("attachments", [{"name": "x", "path": None}]),
        ("duration_s", float("inf")),
        ("held", {"state": "HELD", "moved_m": "far"}),
        ("held", {"state": "HELD", "confirmed": "perhaps"}),
        ("held", {"state": "HELD", "rests_on": "thrust.full_force_n"}),
    ],
)
def test_a_value_of_the_wrong_kind_is_named(folder, key, value):
    change(folder, **{key: value})
    with pytest.raises(DataError, match=key) as caught:
        read_result(folder)
    assert "result.json" in str(caught.value)


@pytest.mark.parametrize("svg", ["<svg><g></svg>", "<svg>&evil;</svg>", "no"])
def test_a_figure_that_is_no_svg_is_named(folder, svg):
    (folder / "figures" / "evil.svg").write_text(svg)
    with pytest.raises(DataError, match=r"evil\.svg: is not an SVG file"):
        write_run_page(folder)


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine to render the page in")
def test_a_browser_runs_and_fetches_nothing_of_a_foreign_folder(served, tmp_path):
    """Not even without the policy of the page."""
    out, asked = served
    page = write_run_page(out)
    page.write_text(re.sub("<meta http-equiv=[^>]*>", "", page.read_text()))
    found = subprocess.run(
        [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--virtual-time-budget=2000",
            "--dump-dom",
            f"file://{page}",
        ],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    ).stdout
    assert "<title>ran</title>" not in found
    assert "data:image/svg+xml" in found
    assert asked == []
