"""Drives the emulated robot with the commands of a recording, through the real drivers of its devices."""

import math
from itertools import pairwise

import numpy as np

from hil.bench import Bench, open_bench
from hil.config.bench import BenchConfig
from hil.controller.joint_script import SCRIPT, JointScript, Stretch
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.signals import CycleRecord, MocapSample, Reference, Status
from hil.datasets.cleaning import Log
from hil.datasets.sequence_times import on_period
from hil.datasets.wheel_log import Recording, build_recording
from hil.recording.runs import RunStart

_BLOCK_S = 0.25
_SAME_RAD_S = 0.08
_TURN_S, _REST_S = 2.5, 1.0
_FEEDBACK = "odometry"


class RecordedCommands(JointScript):
    """The steps of a recorded velocity register as commands, with the recorded path as the reference.

    The wheels first turn to the recorded steering angles, and rest.

    Args:
        recording: run to repeat, with ground truth.
    """

    def __init__(self, recording: Recording) -> None:
        self._truth_t_s = recording.truth_t_s - recording.t_s[0] + _TURN_S + _REST_S
        self._truth = recording.truth_pose
        first = recording.steering_rad[0]
        begin = [Stretch(_TURN_S, steering_rad=first), Stretch(_REST_S)]
        super().__init__([*begin, *_plateaus(recording)], self._truth[0], np.zeros(4))

    def sample(self, t_s: float) -> Reference:
        """Recorded pose at time `t_s`, as a reference at rest: it only bounds where the robot may go."""
        pose = np.array([np.interp(t_s, self._truth_t_s, column) for column in self._truth.T])
        return Reference(t_s, pose, np.zeros(3), np.zeros(3))


def _plateaus(recording: Recording) -> list[Stretch]:
    """Stretches of equal commands: blocks of a quarter of a second whose mean rates are alike are joined."""
    t_s, rates, steering = recording.t_s, recording.wheel_rate_rad_s, recording.steering_rad
    edges = np.searchsorted(t_s, np.arange(t_s[0], t_s[-1], _BLOCK_S))
    blocks = [(a, b) for a, b in pairwise(edges) if b > a]
    means = [np.mean(rates[a:b], axis=0) for a, b in blocks]
    angles = [np.mean(steering[a:b], axis=0) for a, b in blocks]
    times = [t_s[b] - t_s[a] for a, b in blocks]
    groups: list[list[int]] = []
    for k, mean in enumerate(means):
        if groups and np.max(np.abs(mean - means[groups[-1][-1]])) < _SAME_RAD_S:
            groups[-1].append(k)
        else:
            groups.append([k])
    return [
        Stretch(
            float(sum(times[k] for k in group)),
            np.median([means[k] for k in group], axis=0),
            np.median([angles[k] for k in group], axis=0),
            ramp=False,
        )
        for group in groups
    ]


def repeated(recording: Recording, config: BenchConfig, seed: int) -> Recording:
    """The run that the emulated robot makes of a recording's commands.

    Args:
        recording: run to repeat, with ground truth.
        config: bench whose devices are all emulated.
        seed: seed of the emulated world.

    Raises:
        SafetyStop, DeviceError: the emulated robot was stopped.
        DataError: the measurements of the emulated robot cannot be used.
    """
    script, log = RecordedCommands(recording), list[CycleRecord]()
    with open_bench(config, seed=seed, start_pose=script.pose.tolist()) as bench:
        _play(bench, script, log)
    return _as_recording(recording, log)


def _play(bench: Bench, script: RecordedCommands, log: list[CycleRecord]) -> None:
    bench.devices.actuators().enable()
    pipeline = bench.make_pipeline(script, feedback=_FEEDBACK)
    start = RunStart(bench.start_state(script.pose), _FEEDBACK, SCRIPT)
    end_ns = bench.clock.now_ns() + nanoseconds(script.duration_s)

    def until(record: CycleRecord) -> bool:
        log.append(record)
        return record.start_ns >= end_ns

    bench.run(pipeline, start, until, drop_old=False)


def _as_recording(recording: Recording, log: list[CycleRecord]) -> Recording:
    wheels = [w for r in log for w in r.measurements.wheels if all(w.valid)]
    seen = [s for r in log for s in r.inputs.mocap if s.tracking_valid and s.status is Status.OK]
    origin_ns = wheels[0].stamp.t_ns
    values = np.array([[*w.wheel_angle_rad, *w.steering_rad, *w.wheel_rate_rad_s] for w in wheels])
    at_s = np.array([(w.stamp.t_ns - origin_ns) / NS_PER_S for w in wheels])
    seen_s = np.array([(m.stamp.t_ns - origin_ns) / NS_PER_S for m in seen])
    number = np.array([float(m.stamp.seq) for m in seen])
    return build_recording(
        f"{recording.name} emulated",
        Log(at_s, values),
        Log(on_period(seen_s, number), np.array([_pose(m) for m in seen])),
        motion=recording.motion,
        nominal=recording.nominal,
    )


def _pose(sample: MocapSample) -> list[float]:
    """Pose of a sample, m, m, rad, whether or not the bench trusts its capture."""
    w, x, y, z = sample.quaternion_wxyz.tolist()
    theta = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return [float(sample.position_m[0]), float(sample.position_m[1]), theta]
