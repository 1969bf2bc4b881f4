"""Finds the runs in a recording, each with the initial state that replay needs besides the inputs.

One recording holds every run made on the bench (settling, then driving, ...). A note of kind `run`
before its first cycle says which estimator and controller decide, and from which state they start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import DataError
from hil.core.interfaces import RUN_NOTE
from hil.core.signals import CycleRecord, RobotState
from hil.recording.mcap_reader import GO_ON, Note, RecordingReader

START_COVARIANCE = np.diag([1e-8, 1e-8, 1e-7, 1e-6, 1e-6, 1e-6])
"""Covariance of the state that a run begins with, (6, 6): m, m, rad, m/s, m/s and rad/s, squared."""


@dataclass(frozen=True)
class RunStart:
    """Begin of a run.

    Attributes:
        state: state that the pipeline was reset to.
        feedback: estimator in the loop: `odometry`, `ekf` or `ukf`.
        controller: control law, None when nothing was commanded.
        observers: estimators that ran beside it.
        trajectory: description from which the reference is built again (free mapping of the caller), None
            without one.
    """

    state: RobotState
    feedback: str
    controller: str | None = None
    observers: tuple[str, ...] = ()
    trajectory: Mapping[str, Any] | None = None

    def note(self) -> dict[str, object]:
        """The data of the note that records this start; floats survive exactly."""
        state = self.state
        return {
            "state": {
                "t_ns": state.t_ns,
                "pose_body_in_wall": state.pose_body_in_wall.tolist(),
                "twist_body": state.twist_body.tolist(),
                "covariance": state.covariance.tolist(),
            },
            "feedback": self.feedback,
            "controller": self.controller,
            "observers": list(self.observers),
            "trajectory": self.trajectory,
        }

    @classmethod
    def from_note(cls, data: Mapping[str, Any]) -> RunStart:
        """The inverse of `note`.

        Raises:
            KeyError, TypeError, ValueError: the data are not of such a note.
        """
        state, controller, trajectory = data["state"], data["controller"], data["trajectory"]
        if not (controller is None or isinstance(controller, str)):
            raise ValueError("a controller that is no name")
        if not (trajectory is None or isinstance(trajectory, Mapping)):
            raise ValueError("a trajectory that is no mapping")
        pose, twist, covariance = (
            np.array(state[k], dtype=np.float64) for k in ("pose_body_in_wall", "twist_body", "covariance")
        )
        if (pose.shape, twist.shape, covariance.shape) != ((3,), (3,), (6, 6)):
            raise ValueError("a state of the wrong shape")
        return cls(
            RobotState(int(state["t_ns"]), pose, twist, covariance),
            str(data["feedback"]),
            controller,
            tuple(map(str, data["observers"])),
            trajectory,
        )


@dataclass(frozen=True)
class RecordedRun:
    """Cycles of one run; `start` is None where the recording does not say how it began."""

    start: RunStart | None
    records: tuple[CycleRecord, ...]


def read_runs(path: str | Path, problems: list[str] | None = None) -> Iterator[RecordedRun]:
    """Runs of a recording in order; runs without cycles are left out.

    Args:
        path: the MCAP file.
        problems: list that receives what could not be read; without it damage raises after the last run.

    Raises:
        DataError: see `RecordingReader`.
    """
    for _, cycles in groupby(read_cycles_of_runs(path, problems), key=itemgetter(0)):
        found = list(cycles)
        yield RecordedRun(found[0][1], tuple(record for _, _, record in found))


def read_cycles_of_runs(
    path: str | Path, problems: list[str] | None = None, every_ns: int = 0
) -> Iterator[tuple[int, RunStart | None, CycleRecord]]:
    """Every cycle of a recording with the number and the start of its run; see `read_runs`.

    Args:
        path: the MCAP file.
        problems: list for what could not be read, as of `read_runs`.
        every_ns: shortest time between two cycles, ns, as of `RecordingReader.items`.

    Raises:
        DataError: the file is no recording of ours, see `RecordingReader`.
    """
    reader = RecordingReader(path)
    start: RunStart | None = None
    number, latest = 0, -1
    for item in reader.items(every_ns):
        begins = item.kind == RUN_NOTE if isinstance(item, Note) else item.cycle <= latest
        if begins and latest >= 0:
            start, number, latest = None, number + 1, -1
        if not isinstance(item, Note):
            latest = item.cycle
            yield number, start, item
        elif item.kind == RUN_NOTE:
            try:
                start = RunStart.from_note(item.data)
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                reader.problems.append(f"a note on how a run began cannot be read ({error!r})")
    if problems is not None:
        problems += reader.problems
    elif reader.problems:
        raise DataError(str(reader.path), "; ".join(reader.problems), remedy=GO_ON)
