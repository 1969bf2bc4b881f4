"""Writes the last section of `commands.md`, every command with its options, from the help of `hil`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import click

from hil.cli import cli

PAGE = Path(__file__).with_name("commands.md")
HEAD = "## All commands\n"
NOTE = "\nWritten by `docs/make_command_reference.py` from the help of each command.\n"


def page() -> str:
    """The whole page: what a person has written, then the commands."""
    before, _, _ = PAGE.read_text(encoding="utf-8").partition(HEAD)
    return "".join((before, HEAD, NOTE, *_described(cli, click.Context(cli, info_name="hil"))))


def _described(command: click.Command, context: click.Context) -> Iterator[str]:
    """A command, then those below it."""
    if context.parent is not None:
        yield f"\n### {context.command_path}\n"
    yield f"\n```text\n{context.command_path}{''.join(_usage(command))}\n```\n"
    yield from _help(command)
    options = [one for one in command.params if isinstance(one, click.Option) and not one.hidden]
    if options:
        yield "\n| option | meaning |\n|---|---|\n"
        yield from (f"| `{_cell(_names(one))}` | {_cell(_meaning(one))} |\n" for one in options)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            if inner is not None and not inner.hidden:
                yield from _described(inner, click.Context(inner, info_name=name, parent=context))


def _usage(command: click.Command) -> Iterator[str]:
    yield " [OPTIONS]"
    for one in command.params:
        if isinstance(one, click.Argument):
            text = (one.metavar or str(one.name).upper()) + ("..." if one.nargs != 1 else "")
            yield f" {text}" if one.required else f" [{text}]"
    if isinstance(command, click.Group):
        yield " COMMAND [ARGS]..."


def _names(option: click.Option) -> str:
    """Names of an option, and what is to follow them."""
    names = ", ".join(option.opts) + "".join(f" / {name}" for name in option.secondary_opts)
    if option.is_flag or option.count:
        return names
    choices = option.type.choices if isinstance(option.type, click.Choice) else ()
    return f"{names} {option.metavar or '|'.join(map(str, choices)) or option.type.name.upper().split()[0]}"


def _meaning(option: click.Option) -> str:
    """Help of an option with its default and its range."""
    parts = [_plain(option.help or "")]
    kind, facts = option.type, []
    if option.required:
        facts.append("required")
    if option.show_default and not option.is_flag and option.default is not None:
        facts.append(f"default: {option.default}")
    if isinstance(kind, (click.IntRange, click.FloatRange)):
        low = "" if kind.min is None else f"{'above' if kind.min_open else 'at least'} {kind.min:g}"
        high = "" if kind.max is None else f"{'below' if kind.max_open else 'at most'} {kind.max:g}"
        facts += [", ".join(filter(None, (low, high)))]
    return " ".join(parts + [f"[{'; '.join(facts)}]"] * bool(facts))


def _help(command: click.Command) -> Iterator[str]:
    text = inspect.cleandoc(command.help or "").replace("\b\n", "")
    for part in filter(None, re.split(r"\n\s*\n", text)):
        example = re.match(r"Example: (.+)", part, re.S)
        if example:
            yield f"\n```sh\n{inspect.cleandoc(example[1])}\n```\n"
        else:
            yield f"\n{_plain(part)}\n"


def _plain(text: str) -> str:
    """Words in capitals and brackets stay text in Markdown."""
    return re.sub(r"([<*_])", r"\\\1", text) if "`" not in text else text


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
