"""Every command of the command line."""

import click

from hil.cli import cli


def leaves(group=cli, words=()):
    """(words, command) of every command of the tree."""
    for name in group.list_commands(click.Context(group)):
        command = group.get_command(click.Context(group), name)
        if isinstance(command, click.Group):
            yield from leaves(command, (*words, name))
        else:
            yield (*words, name), command
