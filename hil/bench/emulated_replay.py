"""Makes an emulated robot that repeats the motion of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.config.bench import BenchConfig
from hil.core.errors import ConfigError
from hil.datasets.read import read_recordings
from hil.fakes.plant import RecordedMotion, RecordedRobot


def repeating_robot(config: BenchConfig) -> RecordedRobot:
    """The robot of `emulation.replay`.

    Raises:
        ConfigError: the path holds more than one recording.
        DataError: it cannot be read, or is too short.
    """
    emulation, alignment = config.emulation, config.alignment
    path = str(emulation.replay)
    found = read_recordings([Path(path)])
    if len(found) != 1:
        raise ConfigError(
            f"emulation.replay: {path} holds {len(found)} recordings", expected="one", remedy="name one file"
        )
    recording = found[0]
    motion = RecordedMotion(
        recording.name,
        recording.t_s,
        np.column_stack(
            [
                np.array(alignment.drive_sign) * recording.wheel_angle_rad,
                np.array(alignment.steer_sign) * recording.steering_rad + np.array(alignment.steer_zero_rad),
            ]
        ),
        recording.truth_t_s,
        recording.truth_pose,
    )
    return RecordedRobot(motion, tilt_rad=config.environment.tilt_rad, after_s=emulation.replay_after_s)
