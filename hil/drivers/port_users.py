"""Which programs have a port open, and which run: read from `/proc`, as far as this user may."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PROC = Path("/proc")


class Program(NamedTuple):
    """A running program."""

    pid: int
    name: str


def running(proc: Path = PROC) -> Iterator[Program]:
    """All programs of this machine."""
    for folder in proc.glob("[0-9]*"):
        try:
            yield Program(int(folder.name), (folder / "comm").read_text(errors="replace").strip())
        except (OSError, ValueError):
            continue


def programs_with(port: str, proc: Path = PROC) -> list[Program]:
    """Other programs that have a port open; those of other users are seen by root only.

    Args:
        port: device path, or a link to one.
        proc: where the kernel tells of programs.
    """
    device = os.path.realpath(port)
    return sorted(p for p in running(proc) if p.pid != os.getpid() and _has_open(proc / str(p.pid), device))


def _has_open(program: Path, device: str) -> bool:
    try:
        links = list((program / "fd").iterdir())
    except OSError:
        return False
    for link in links:
        try:
            if os.readlink(link) == device:
                return True
        except OSError:
            continue
    return False


def named(programs: list[Program]) -> str:
    """Programs in words: `minicom (process 812)`."""
    return ", ".join(f"{program.name} (process {program.pid})" for program in programs)
