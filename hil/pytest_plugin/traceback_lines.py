"""Tracebacks of interrupted sessions with a line in every entry.

In CPython 3.11 some jumps back to the head of a loop have no line. A signal is heeded at such a jump, too.
Then `tb_lineno` of its frame is None, and pytest's report of the interrupt ends with a TypeError and 1.
"""

from __future__ import annotations

from types import CodeType, TracebackType


def with_lines(traceback: TracebackType) -> None:
    """Give entries without a line that of the instruction before, in place.

    Args:
        traceback: first entry of the traceback; it has a line.
    """
    entry = traceback
    while (following := entry.tb_next) is not None:
        number: int | None = following.tb_lineno
        if number is None:
            frame, place = following.tb_frame, following.tb_lasti
            line = line_before(frame.f_code, place)
            entry.tb_next = following = TracebackType(following.tb_next, frame, place, line)
        entry = following


def line_before(code: CodeType, offset: int) -> int:
    """Return the line of the last instruction that has one, up to an offset in bytes; else the function's."""
    lines = [line for start, _, line in code.co_lines() if start <= offset and line is not None]
    return lines[-1] if lines else code.co_firstlineno
