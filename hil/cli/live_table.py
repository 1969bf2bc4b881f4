"""Table of a running bench on a terminal: rate, age, state and values of every device, rewritten in place.

The figures are those of the console (`hil.monitor.status_stream`). A thread lays them out and writes them:
neither that nor a terminal that stands still (Ctrl-S) holds up the loop. Figures that it cannot take are left
out. When the loop has ended, what is seen of the robot takes the place of figures that are true no more.
"""

import os
import textwrap
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import degrees, hypot
from queue import Full, Queue
from typing import Any, TextIO

from hil.config.bench import BenchConfig
from hil.core.clock import Clock
from hil.core.kind_figures import Limited, unlimited
from hil.monitor.status_stream import StatusStream

_CLEAR = "\x1b[J"
_LONGEST_WAIT_S = 1.0
_SPARE_ROWS = 3
_COLUMNS, _ROWS = 80, 24
"""Size of a terminal that does not tell its own."""
_SHOWN = ("live", "watched")
_Figures = Mapping[str, Any]


class LiveTable(StatusStream):
    """Shows the figures of the loop twice a second, below everything that was printed before.

    Args:
        terminal: terminal to write to.
        clock: the host's.
        config: configuration of the bench.
        limited: time limit of the figures of a device's package, as of `KindFigures`.
    """

    def __init__(
        self, terminal: TextIO, clock: Clock, config: BenchConfig, limited: Limited = unlimited
    ) -> None:
        super().__init__(self._show, clock, config, limited)
        self._terminal = terminal.fileno()
        self._waiting: Queue[tuple[str, _Figures] | None] = Queue(1)
        self._writer: threading.Thread | None = None

    def close(self) -> None:
        """Remove the table."""
        super().close()
        if self._writer is None:
            return
        try:
            self._waiting.put(None, timeout=_LONGEST_WAIT_S)
            self._writer.join(_LONGEST_WAIT_S)
        except Full:  # the terminal stands still, and the thread is left to it
            pass
        self._writer = None

    def _show(self, kind: str, figures: _Figures) -> None:
        if kind not in _SHOWN:
            return
        if self._writer is None:
            self._writer = threading.Thread(target=self._write, args=(self._waiting,), daemon=True)
            self._writer.start()
        with suppress(Full):
            self._waiting.put_nowait((kind, figures))

    def _write(self, waiting: Queue[tuple[str, _Figures] | None]) -> None:
        with suppress(OSError):  # the terminal is gone; the session notices by itself
            while True:
                told = waiting.get()
                data = (_CLEAR if told is None else self._text(*told)).encode()
                while data:
                    data = data[os.write(self._terminal, data) :]
                if told is None:
                    return

    def _text(self, kind: str, figures: _Figures) -> str:
        """The table for the terminal, as wide and high as it is now."""
        size = os.get_terminal_size(self._terminal)
        lines = [figures["words"]] if kind == "watched" else [_motion(figures), *table(figures)]
        return frame(lines, size.columns or _COLUMNS, size.lines or _ROWS)


def frame(whole: Sequence[str], columns: int, rows: int) -> str:
    """The table as text for a terminal; leaves the cursor above it, where the next message goes.

    Args:
        whole: lines of the table, or on a robot that is watched without a loop.
        columns: width of the terminal; longer lines go on in the next one.
        rows: height of the terminal; values that do not fit are left out.
    """
    lines = [part for line in whole for part in textwrap.wrap(line, columns - 1, subsequent_indent="    ")]
    room = max(rows - _SPARE_ROWS, 1)
    if len(lines) > room:
        hidden = len(lines) - room + 1
        lines = [*lines[: room - 1], f"{hidden} more lines: make the window taller"]
    shown = "".join(f"\n{line}" for line in lines)
    return f"\r{_CLEAR}{shown}\r\x1b[{len(lines)}A"


def table(figures: _Figures) -> list[str]:
    """Lines of the table: first every device, then the values of each."""
    devices: Mapping[str, _Figures] = figures["devices"]
    lines = [f"{'device':12} {'rate':>14} {'age':>9}  state"]
    for name, device in devices.items():
        due = f" of {_short(device['due_hz'])}" if device["due_hz"] else ""
        rate = f"{_short(device['rate_hz'])}{due} Hz"
        age = "-" if device["age_ms"] is None else f"{max(0.0, device['age_ms']):.0f} ms"
        lines.append(f"{name:12} {rate:>14} {age:>9}  {device['status']}")
    for name, device in devices.items():
        for title, values in device["values"].items():
            written = "  ".join(f"{key} {_short(value)}" for key, value in values.items())
            lines.append(f"{name}: {title}:  {written}")
    return lines


def _motion(figures: _Figures) -> str:
    """The line on the robot: bench, time, pose, speed, force that holds it."""
    (x, y, heading), (ahead, left, _) = figures["pose"], figures["twist"]
    parts = [f"{figures['bench']} ({figures['robot']} robot)  {figures['t_s']:.1f} s"]
    if None not in (x, y, heading):
        parts.append(f"x {1e3 * x:.1f} mm  y {1e3 * y:.1f} mm  heading {degrees(heading):.1f} deg")
    if None not in (ahead, left):
        parts.append(f"{1e3 * hypot(ahead, left):.0f} mm/s")
    if figures["adhesion_n"] is not None:
        parts.append(f"pressed on: {figures['adhesion_n']:.0f} N")
    return "  ".join(parts)


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
