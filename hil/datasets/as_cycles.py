"""Converts recordings of other origin to cycle records: one cycle per wheel sample.

Nothing is estimated or commanded in such a run. It serves to be replayed through estimators, plotted, and
compared like a run of the bench. It begins where odometry begins in `hil evaluate`.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.geometry import Array
from hil.core.signals import (
    CycleRecord,
    Inputs,
    Measurements,
    PoseMeasurement,
    RobotState,
    ServoSetpoint,
    Stamp,
    WheelMeasurement,
    WheelSetpoint,
)
from hil.datasets.bag_sensors import between, shifted
from hil.datasets.sampling import interpolate, truth_window, wheel_edges
from hil.datasets.start_pose import start_of
from hil.datasets.wheel_log import Recording
from hil.loop.alignment import Alignment
from hil.recording.runs import START_COVARIANCE, RecordedRun, RunStart

_USABLE = (True,) * 4


def to_run(recording: Recording, *, on_wall: bool) -> RecordedRun:
    """Convert a recording to a run that starts at its first ground truth in the wheel log; see `start_of`.

    Without ground truth it starts at the origin, with the first wheel row.

    Args:
        recording: recording of other origin.
        on_wall: True where gravity lies in the motion plane.
    """
    start = RobotState(0, start_of(recording).pose, np.zeros(3), START_COVARIANCE)
    return RecordedRun(RunStart(start, "odometry"), to_cycles(_from_first_truth(recording), on_wall=on_wall))


def _from_first_truth(recording: Recording) -> Recording:
    """Cut the wheel rows before the first ground truth, and interpolate the wheels at that instant."""
    if not recording.has_truth:
        return recording
    at_s = wheel_edges(recording, truth_window(recording)[0][0], recording.t_s[-1])
    angle, steering, rate, receive_s = (
        interpolate(at_s, recording.t_s, values)
        for values in (
            recording.wheel_angle_rad,
            recording.steering_rad,
            recording.wheel_rate_rad_s,
            recording.receive_s[:, None],
        )
    )
    return replace(
        recording,
        t_s=at_s,
        wheel_angle_rad=angle,
        steering_rad=steering,
        wheel_rate_rad_s=rate,
        receive_s=receive_s[:, 0],
    )


def to_cycles(recording: Recording, *, on_wall: bool) -> tuple[CycleRecord, ...]:
    """Convert every wheel row of a recording to a cycle, with all other samples since the row before.

    Args:
        recording: recording of other origin.
        on_wall: True where gravity lies in the motion plane.
    """
    t_ns = [nanoseconds(t) for t in (recording.t_s - recording.t_s[0]).tolist()]
    edges = np.searchsorted(recording.truth_t_s, recording.t_s, side="right")
    rates = _rates(recording)
    alignment = Alignment(replace(recording.sensors.parameters, on_wall=on_wall))
    records = []
    for k, (now_ns, inputs) in enumerate(zip(t_ns, _inputs(recording, t_ns), strict=True)):
        seen = range(int(edges[k - 1]) if k else 0, int(edges[k]))
        wheels = WheelMeasurement(
            Stamp(now_ns, now_ns, k),
            recording.wheel_angle_rad[k],
            rates[k],
            recording.steering_rad[k],
            _USABLE,
        )
        measured = replace(
            alignment.measure(inputs), wheels=(wheels,), mocap=tuple(_truth(recording, i) for i in seen)
        )
        records.append(_cycle(inputs, measured))
    return tuple(records)


def _inputs(recording: Recording, t_ns: list[int]) -> Iterator[Inputs]:
    """Samples of IMU and camera in each cycle, with stamps since the first row."""
    own = shifted(recording.sensors, float(recording.t_s[0]), float(recording.t_s[0]))
    since_s = recording.t_s - recording.t_s[0]
    both = zip(between(own.imu, since_s), between(own.tracker, since_s), strict=True)
    for k, (imu, tracker) in enumerate(both):
        yield Inputs(k, t_ns[k], imu=tuple(imu), tracker=tuple(tracker))


def _rates(recording: Recording) -> Array:
    if recording.has_rates:
        return recording.wheel_rate_rad_s
    return np.asarray(np.gradient(recording.wheel_angle_rad, recording.t_s, axis=0), dtype=np.float64)


def _truth(recording: Recording, i: int) -> PoseMeasurement:
    t_ns = nanoseconds(float(recording.truth_t_s[i] - recording.t_s[0]))
    return PoseMeasurement(Stamp(t_ns, t_ns, i), "mocap", recording.truth_pose[i], 3, True)


def _cycle(inputs: Inputs, measured: Measurements) -> CycleRecord:
    """Cycle record with samples and measurements only; estimate and commands are NaN."""
    t_ns, unknown, none = measured.t_ns, np.full(3, np.nan), np.full(4, np.nan)
    return CycleRecord(
        measured.cycle,
        t_ns,
        t_ns,
        inputs,
        measured,
        RobotState(t_ns, unknown, unknown, np.full((6, 6), np.nan)),
        None,
        WheelSetpoint(none, none),
        ServoSetpoint(none, none),
    )
