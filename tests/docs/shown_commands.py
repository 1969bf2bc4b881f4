"""Commands as pages, messages and remedies show them, held against what the command line has."""

import ast
import re
import shlex
from itertools import pairwise

import click

from hil.cli import COMMANDS, cli
from hil.procedure.shipped import shipped_names

ANY = "ANYTHING"
"""Stands for what a message fills in."""

NOT_COMMANDS = {"import", "monitor", "monitor:"}
"""Words that follow `hil` in strings that are no commands: code, and what the monitor says of itself."""

PROCEDURES = shipped_names()
HELP = {"--help", "-h", "--version", "-v", "--verbose"}


def problem(words):
    """What is wrong with `hil WORDS...`; empty when command, options and choices exist."""
    if not words or words[0].startswith("-"):
        return "" if set(words) <= HELP else f"no such option {words}"
    if words[0] not in COMMANDS:
        return f"no command {words[0]!r}"
    command, rest = cli.get_command(click.Context(cli), words[0]), list(words[1:])
    while isinstance(command, click.Group):
        name = next((w for w in rest if not w.startswith("-")), None)
        if name is None:
            return ""
        rest.remove(name)
        found = command.get_command(click.Context(command), name)
        if found is None:
            return f"no command {words[0]} {name}"
        command = found
    if words[0] == "run" and re.fullmatch(r"[a-z_]+", rest[0] if rest else ANY) and rest[0] not in PROCEDURES:
        return f"no procedure {rest[0]}"
    known = {o: p for p in command.params for o in (*p.opts, *p.secondary_opts) if o.startswith("-")}
    for word, following in pairwise([*rest, ""]):
        option, _, given = word.partition("=")
        if not re.match(r"--?[a-z]", option) or option in HELP:
            continue
        if option not in known:
            return f"hil {words[0]} has no option {option}"
        kind, value = known[option].type, given or following
        if (
            isinstance(kind, click.Choice)
            and ANY not in value
            and not set(value.split("|")) <= set(kind.choices)
        ):
            return f"hil {words[0]} {option} is not {value!r}"
    return ""


def in_text(text):
    """Commands that a sentence shows: in backticks, or after the word hil."""
    quoted = re.findall(r"`hil ([^`]+)`", text)
    plain = re.findall(r"(?<![`/.\w])hil ([a-z][^`;,()\n]*)", re.sub(r"`[^`]*`", "", text))
    for line in quoted + [p for p in plain if p.split()[0] not in NOT_COMMANDS]:
        yield [word.strip(".") for word in line.split() if word.strip(".")]


def in_block(block):
    """Commands of a shell block."""
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if "hil" in words[:2]:
            words = words[words.index("hil") + 1 :]
            yield words[: next((i for i, w in enumerate(words) if w in ("&", ">", "|", "&&")), None)]


def strings(source):
    """Every string of a module, with `ANY` where something is filled in."""
    inside = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            inside |= {id(part) for part in node.values}
            yield "".join(str(p.value) if isinstance(p, ast.Constant) else ANY for p in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
            yield node.value
