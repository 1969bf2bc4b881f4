"""No page, help text, public docstring or text of the program uses a word that docs/wording.toml replaces."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import click
import pytest

from hil.cli import cli

try:
    import tomllib
except ModuleNotFoundError:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
PAIRS = tomllib.loads((ROOT / "docs" / "wording.toml").read_text(encoding="utf-8"))["pair"]
PAGES = sorted(
    [
        *ROOT.glob("[PCRS]*.md"),
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "examples").rglob("*.md"),
        *(ROOT / "docs" / "ci-template").glob("*.md"),
    ]
)
UNCHECKED = {"CHANGELOG.md"}


def found(text):
    """(line, private word, what to write instead) of a text, code left out; a phrase may span two lines."""
    text = re.sub(r"^```.*?^```", lambda m: "\n" * m[0].count("\n"), text, flags=re.S | re.M)
    text = re.sub(r"`[^`]*`|\]\([^)]*\)", lambda m: "\n" * m[0].count("\n"), text)
    for pair in PAIRS:
        pattern = pair["private"].replace(" ", r"\s+")
        for match in re.finditer(pattern, text, re.IGNORECASE):
            yield text.count("\n", 0, match.start()) + 1, " ".join(match[0].split()), pair["instead"]


def helps(command=cli, words=("hil",)):
    """(name, text) of every command and option."""
    yield " ".join(words), command.help or ""
    for parameter in command.params:
        yield f"{' '.join(words)} {parameter.name}", getattr(parameter, "help", "") or ""
    if isinstance(command, click.Group):
        for name in command.list_commands(click.Context(command)):
            yield from helps(command.get_command(click.Context(command), name), (*words, name))


def docstrings(thing, name):
    """(name, docstring) of a public thing and of what is defined in it."""
    yield name, inspect.getdoc(thing) or ""
    if inspect.ismodule(thing) or inspect.isclass(thing):
        home = thing.__name__ if inspect.ismodule(thing) else thing.__module__
        for key, inner in vars(thing).items():
            inner = getattr(inner, "fget", inner)
            if (
                not key.startswith("_")
                and getattr(inner, "__module__", "") == home
                and callable(inner)
                and inner.__name__ == key
            ):
                yield from docstrings(inner, f"{name}.{key}")


def public():
    """Everything on the page of the Python reference."""
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    for kind, name in re.findall(r"^\.\. auto(\w+):: ([\w.]+)", page, re.M):
        module, _, last = name.rpartition(".")
        thing = (
            importlib.import_module(name)
            if kind == "module"
            else getattr(importlib.import_module(module), last)
        )
        yield from docstrings(thing, name)


def strings(source):
    """(line, text) of every string with a space in it but docstrings, with {} for what is filled in."""
    nodes = list(ast.walk(ast.parse(source)))
    apart = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            apart |= {id(part) for part in node.values}
            parts = [part.value if isinstance(part, ast.Constant) else "{}" for part in node.values]
            text = "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in apart:
            text = node.value
        else:
            continue
        if " " in text:
            yield node.lineno, text


@pytest.mark.parametrize(
    "page", [p for p in PAGES if p.name not in UNCHECKED], ids=lambda p: str(p.relative_to(ROOT))
)
def test_a_page_says_it_plainly(page):
    assert list(found(page.read_text(encoding="utf-8"))) == []


def test_help_texts_say_it_plainly():
    texts = dict(helps())
    assert len(texts) > 150
    assert [(name, hit) for name, text in texts.items() for hit in found(text)] == []


def test_public_docstrings_say_it_plainly():
    texts = dict(public())
    assert len(texts) > 150
    assert [(name, hit) for name, text in texts.items() for hit in found(text)] == []
    assert [name for name, text in texts.items() if not text] == []


def test_texts_of_the_program_say_it_plainly():
    files = [path for folder in ("hil", "procedures") for path in (ROOT / folder).rglob("*.py")]
    texts = {
        (str(path.relative_to(ROOT)), line, text)
        for path in files
        for line, text in strings(path.read_text(encoding="utf-8"))
    }
    assert len(texts) > 2000
    assert [(file, line, hit[1:]) for file, line, text in sorted(texts) for hit in found(text)] == []


def test_strings_are_found_without_docstrings_and_with_what_is_filled_in():
    source = '''def f(x):
    """It tells a lie."""
    g(f"servo {x or 'nobody knows'} of " "the {bench}", 'one', key="and two")
'''
    assert sorted(text for _, text in strings(source)) == [
        "and two",
        "nobody knows",
        "servo {} of the {bench}",
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("the play of a gear", ["play"]),
        ("it is\ntold as a warning", ["is told"]),
        ("they cannot be told apart", []),
        ("run `ros2 bag play` on it", []),
        ("```sh\nplay it\n```\nand play it", ["play"]),
    ],
)
def test_a_private_word_is_found_where_it_stands(text, words):
    assert [word for _, word, _ in found(text)] == words
