"""Finds the programs that have a port or a socket open, by `/proc`, as far as this user may read it."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PROC = Path("/proc")
_PTS = "/dev/pts/"


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

    A program at the other end of a pseudo-terminal is what the port leads to, and not counted.

    Args:
        port: device path, or a link to one.
        proc: folder in which the kernel lists programs.
    """
    path = os.path.realpath(port)
    found = _with_open({path}, proc)
    if not path.startswith(_PTS):
        return found
    return [program for program in found if not _is_other_end(proc / str(program.pid), path[len(_PTS) :])]


def is_pseudo_terminal(port: str) -> bool:
    """Whether a program of this computer is at the other end of a port.

    Args:
        port: device path, or a link to one.
    """
    return os.path.realpath(port).startswith(_PTS)


def programs_behind(port: str, proc: Path = PROC) -> list[Program]:
    """Other programs at the other end of a pseudo-terminal; those of other users are seen by root only.

    Args:
        port: device path, or a link to one; no program is at the other end of what is no pseudo-terminal.
        proc: folder in which the kernel lists programs.
    """
    if not is_pseudo_terminal(port):
        return []
    number = os.path.realpath(port)[len(_PTS) :]
    others = (program for program in running(proc) if program.pid != os.getpid())
    return sorted(program for program in others if _is_other_end(proc / str(program.pid), number))


def own_descriptors_of(path: str, proc: Path = PROC) -> int:
    """Number of descriptors of this process that lead to a file; its other threads may open and close files.

    Args:
        path: the file, without links.
        proc: folder in which the kernel lists programs.
    """
    return sum(file == path for file in _opened(proc / str(os.getpid())))


def _is_other_end(program: Path, number: str) -> bool:
    """Whether a program has the master of the pseudo-terminal of this number."""
    with contextlib.suppress(OSError):
        for description in (program / "fdinfo").iterdir():
            with contextlib.suppress(OSError):
                if f"tty-index:\t{number}\n" in description.read_text(errors="replace"):
                    return True
    return False


def programs_with_udp(port: int, proc: Path = PROC) -> list[Program]:
    """Other programs that have an IPv4 UDP port of this computer.

    Args:
        port: its number.
        proc: folder in which the kernel lists programs.
    """
    rows = (line.split() for line in _lines(proc / "net" / "udp"))
    return _with_open(
        {f"socket:[{r[9]}]" for r in rows if len(r) > 9 and r[1].endswith(f":{port:04X}")}, proc
    )


def programs_with_name(name: str, proc: Path = PROC) -> list[Program]:
    """Other programs that have an abstract Unix address.

    Args:
        name: text of the address, without its leading zero byte.
        proc: folder in which the kernel lists programs.
    """
    rows = (line.split() for line in _lines(proc / "net" / "unix"))
    return _with_open({f"socket:[{r[6]}]" for r in rows if len(r) > 7 and r[7] == f"@{name}"}, proc)


def _lines(table: Path) -> list[str]:
    try:
        return table.read_text(errors="replace").splitlines()
    except OSError:
        return []


def _with_open(files: set[str], proc: Path) -> list[Program]:
    """Other programs that have one of these files open; without files no program is examined."""
    if not files:
        return []
    return sorted(p for p in running(proc) if p.pid != os.getpid() and _has_open(proc / str(p.pid), files))


def _has_open(program: Path, files: set[str]) -> bool:
    return any(file in files for file in _opened(program))


def _opened(program: Path) -> Iterator[str]:
    """Files that a program has open; those that it closes meanwhile may be missing."""
    with contextlib.suppress(OSError):
        for link in (program / "fd").iterdir():
            with contextlib.suppress(OSError):
                yield os.readlink(link)


def ending(programs: list[Program]) -> str:
    """How to end programs, as an insertion in a sentence: ` (kill 812)`; empty for none."""
    return f" (kill {' '.join(str(program.pid) for program in programs)})" if programs else ""


def named(programs: list[Program]) -> str:
    """Programs in words: `minicom (process 812)`."""
    return ", ".join(f"{program.name} (process {program.pid})" for program in programs)
