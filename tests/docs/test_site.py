"""The documentation site: every page has its place, a guide says what it leads to, the build is clean."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
INDEX = (DOCS / "index.md").read_text(encoding="utf-8")
TREES = dict(
    re.findall(
        r"^```{toctree}\n:caption: (\w+)\n.*?\n\n(.*?)```", re.sub(r".+<(.+)>", r"\1", INDEX), re.S | re.M
    )
)


def test_every_page_has_its_place_once():
    listed = [name for tree in TREES.values() for name in tree.split()]
    there = {str(p.relative_to(DOCS).with_suffix("")) for p in DOCS.glob("*.md")} - {"index"}
    assert sorted(n for n in listed if "/" not in n) == sorted(there)
    assert [n for n in listed if not (DOCS / f"{n}.md").exists()] == []
    assert list(TREES) == ["Begin", "Laboratory", "Contributor", "Reference"]


@pytest.mark.long
def test_the_site_is_built_without_a_warning_and_needs_no_network(tmp_path):
    pytest.importorskip("furo", reason="the extra docs is not installed")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-c", str(DOCS)]
    done = subprocess.run([*build, str(ROOT), str(tmp_path)], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    for page in tmp_path.rglob("*.html"):
        loaded = re.findall(
            r'<(?:script|link|img)[^>]*?(?:src|href)="(https?:[^"]+)', page.read_text(encoding="utf-8")
        )
        assert loaded == [], page
    assert (tmp_path / "searchindex.js").stat().st_size > 100_000
    commands = (tmp_path / "docs" / "commands.html").read_text(encoding="utf-8")
    assert re.search(r"<h[2-5]>hil results trends<", commands)
    assert "hil command" not in commands
    assert 'href="docs/hardware.html"' in (tmp_path / "README.html").read_text(encoding="utf-8")
