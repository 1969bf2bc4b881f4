"""The page of a live session: how it ended, its faults and events, and figures from its recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.bench.hold.held_state import held_in_words
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DataError, shown_path
from hil.core.event_rows import event_lines
from hil.core.interfaces import Sink
from hil.core.known_names import JOG
from hil.core.registry import kinds
from hil.core.result_names import LIVE_RECORDING, SESSION, SESSION_PAGE, end_of_session
from hil.core.signals import WHEELS, CycleRecord
from hil.recording.mcap_reader import RecordingReader
from hil.recording.runs import read_cycles_of_runs
from hil.report import device_history, holding_force_history, path_history
from hil.report.figure_rows import DrivenRows
from hil.report.overview import Drawn, Overview, Table, write_overview
from hil.report.page_formats import duration
from hil.report.result_reader import own_file
from hil.support.file_reading import read_json
from hil.support.progress import Report, silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EVERY_NS = nanoseconds(0.05)
_WHEELS_CAPTION = "As the servos measured them."


class WheelHistory(Sink):
    """Collects rates and steering angles of the wheels, twenty times a second."""

    def __init__(self) -> None:
        self._driven = DrivenRows(_EVERY_NS)

    def write(self, record: CycleRecord) -> None:
        """Add one record."""
        t_ns, wheels = record.inputs.t_ns, record.measurements.wheels
        if wheels and (self._driven.begin_anew(t_ns) or self._driven.is_due(t_ns)):
            self._driven.add(t_ns, *wheels[-1].wheel_rate_rad_s, *wheels[-1].steering_rad)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def figure(self) -> Figure | None:
        """Draw rates and angles over time, a line per wheel; None without a measurement."""
        from hil.report.plot_style import SERIES, legend, new_figure, style

        if len(self._driven.rows) < 2:
            return None
        rows = np.array(self._driven.rows)
        figure = new_figure(5.2, 4.2)
        for place, label in ((1, "rate (rad/s)"), (2, "steering angle (deg)")):
            axes = style(figure.add_subplot(2, 1, place), "time driven (s)" if place == 2 else "", label)
            for k, name in enumerate(WHEELS):
                values = rows[:, 1 + k] if place == 1 else np.degrees(rows[:, 5 + k])
                axes.plot(rows[:, 0], values, color=SERIES[k], lw=1.3, label=name)
            if place == 1:
                legend(axes, columns=4, above=True)
        return figure


def write_session_page(folder: Path, report: Report = silent) -> Path:
    """Write the page of a live session beside its `session.json`; return its path.

    Args:
        folder: folder of the session.
        report: progress of reading its recording.

    Raises:
        DataError: there is no such session, it has no recording, or the page cannot be written.
    """
    tree = read_json(folder / SESSION)
    if not isinstance(tree, dict):
        raise DataError(str(folder / SESSION), "is no live session")
    written = tree.get("recording")
    recording = Path(str(written["path"])) if isinstance(written, dict) else folder / LIVE_RECORDING
    recording = recording if recording.is_file() else folder / LIVE_RECORDING
    problems: list[str] = []
    figures: list[Drawn] = []
    seconds = 0.0
    if recording.is_file():
        cycles = int(written.get("written", 0)) if isinstance(written, dict) else 0
        figures, seconds = _figures(recording, problems, lambda done: _tell(report, done, cycles))
    held, faults = tree.get("held"), [str(fault) for fault in tree.get("faults") or ()]
    end = end_of_session(str(tree.get("ended")), str(held.get("state"))) if isinstance(held, dict) else "?"
    sentence = "It still runs, or was killed."
    if isinstance(held, dict):
        sentence = f"{end}. Ended by: {tree.get('ended')}. {held_in_words(held)}."
    page = Overview(
        title=" ".join(filter(None, (str(tree.get("command")), str(tree.get("moves", ""))))),
        sentence=sentence,
        figures=figures,
        tables=list(_tables(tree)),
        warnings=[*(f"injected: {fault}" for fault in faults), *event_lines(_rows(tree)), *problems],
        facts=list(_facts(tree, recording, seconds)),
    )
    return write_overview(own_file(folder, SESSION_PAGE), page)


def _tell(report: Report, cycle: int, cycles: int) -> None:
    """Report how much of a recording of so many cycles is read, if the number is known."""
    if cycles:
        report("reading the recording", min(cycle, cycles), cycles)


def _figures(
    recording: Path, problems: list[str], read: Callable[[int], object]
) -> tuple[list[Drawn], float]:
    """Return figures of a recording, and its duration in s; call `read` with the number of each cycle."""
    path, hold = path_history.PathHistory(), holding_force_history.HoldHistory()
    devices, wheels = device_history.DeviceHistory(), WheelHistory()
    first_ns, last_ns, of_joint = None, 0, False
    # samples of an added kind may be rare, and are looked for in every cycle
    every_ns = 0 if RecordingReader(recording).packages else _EVERY_NS
    for _, start, record in read_cycles_of_runs(recording, problems, every_ns):
        read(record.cycle)
        of_joint |= start is not None and (start.controller or "").startswith(JOG)
        for sink in (path, hold, devices, wheels):
            sink.write(record)
        first_ns, last_ns = record.start_ns if first_ns is None else first_ns, record.start_ns
    shown = [
        ("wheels", "Wheels", wheels.figure(), _WHEELS_CAPTION),
        # odometry of one wheel that turns alone is not the robot's path
        ("path", "Path", None if of_joint else path.figure(), path_history.CAPTION),
        ("adhesion", "Adhesion", hold.figure(), holding_force_history.CAPTION),
        *(
            (name, kinds()[name].noun.capitalize(), f, device_history.CAPTION)
            for name, f in devices.figures()
        ),
    ]
    drawn = [Drawn(name, title, figure, caption) for name, title, figure, caption in shown if figure]
    return drawn, (last_ns - (first_ns or last_ns)) / NS_PER_S


def _facts(tree: Mapping[str, Any], recording: Path, seconds: float) -> Iterator[str]:
    emulated, real = (", ".join(map(str, tree.get(key) or ())) for key in ("emulated", "real"))
    yield f"began {str(tree.get('began')).replace('T', ' ')}, {duration(seconds)} recorded"
    first_s = tree.get("first_cycle_s")
    if isinstance(first_s, float):
        yield (
            "times of events count from the opening of the bench; the figures begin with the first cycle, "
            f"{first_s:.2f} s later, and leave pauses out"
        )
    yield f"bench {tree.get('bench')}; real: {real or 'none'}; emulated: {emulated or 'none'}"
    if recording.is_file():
        yield f"recording; to compare estimators: hil replay {shown_path(recording)} --page compared.html"


def _rows(tree: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    events = tree.get("events")
    return events if isinstance(events, list) else ()


def _tables(tree: Mapping[str, Any]) -> Iterator[Table]:
    samples = tree.get("samples")
    if isinstance(samples, dict):
        rows = [
            [
                name,
                str(n["received"]),
                str(n["missing"]),
                ", ".join(f"{k} {kind}" for kind, k in n["bad"].items()),
            ]
            for name, n in samples.items()
        ]
        yield Table("Samples", ("device", "received", "missing", "bad"), rows)
