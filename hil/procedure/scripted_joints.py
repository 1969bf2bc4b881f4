"""Drives the joints from a script instead of a trajectory, through the same loop, supervisor and sinks.

For procedures that examine single joints (turn one steering servo, roll one wheel) or that need the exact
command at each time. The robot stands still before and after.
"""

from collections.abc import Sequence

from hil.bench import Bench
from hil.controller.joint_script import SCRIPT, JointScript, Stretch
from hil.core.clock import nanoseconds
from hil.core.geometry import Array, ArrayLike
from hil.core.signals import CycleRecord
from hil.loop.driven_motion import Motion
from hil.recording.runs import RunStart

__all__ = ["Stretch", "play"]

_FEEDBACK = "odometry"


def play(bench: Bench, stretches: Sequence[Stretch], start_pose: ArrayLike, steering_rad: Array) -> Motion:
    """Enable the servos, run a script of joint commands, hold; odometry tracks the robot's pose.

    Args:
        bench: open bench.
        stretches: parts of the script, in order.
        start_pose: pose of the robot, (3,); the supervisor's limits on heading and distance apply.
        steering_rad: current steering angles, (4,).

    Raises:
        SafetyStop, DeviceError: in each case the robot is stopped.
    """
    script = JointScript(stretches, start_pose, steering_rad)
    bench.devices.actuators().enable()
    pipeline = bench.make_pipeline(script, feedback=_FEEDBACK)
    start = RunStart(bench.start_state(script.pose), _FEEDBACK, SCRIPT, trajectory=script.to_mapping())
    end_ns = bench.clock.now_ns() + nanoseconds(script.duration_s)
    log = bench.new_log()

    def until(record: CycleRecord) -> bool:
        log.append(record)
        return record.start_ns >= end_ns

    bench.run(pipeline, start, until, drop_old=False)
    return log.motion()
