"""Advice can be followed: every command that a message, a remedy or a page shows exists, with its options."""

import re
from pathlib import Path

import pytest
from shown_commands import in_block, in_text, problem, strings

from tests.command_tree import leaves

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted([*(ROOT / "hil").rglob("*.py"), *(ROOT / "procedures").rglob("*.py")])
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.md")])


def test_every_command_in_a_message_exists():
    shown = [
        (path.relative_to(ROOT), words)
        for path in SOURCES
        for text in strings(path.read_text(encoding="utf-8"))
        for words in in_text(text)
    ]
    assert len(shown) > 30
    assert [(str(path), words, reported) for path, words in shown if (reported := problem(words))] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_command_on_a_page_exists_with_its_options(page):
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    shown = [words for block in blocks for words in in_block(block)]
    shown += [line.replace("\\|", "|").split() for line in re.findall(r"`hil ([^`]+)`", prose)]
    assert [(words, reported) for words in shown if (reported := problem(words))] == []


def test_the_help_of_every_command_gives_an_example_of_it():
    shown = {
        " ".join(words): re.findall(r"^ *Example: hil (.+)$", command.help, re.M)
        for words, command in leaves()
    }
    assert len(shown) > 30
    assert [
        n for n, lines in shown.items() if len(lines) != 1 or not f"{lines[0]} ".startswith(f"{n} ")
    ] == []
    assert [(n, reported) for n, lines in shown.items() if (reported := problem(lines[0].split()))] == []
