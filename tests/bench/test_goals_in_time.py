"""However bus or servos fail: by the chips' own registers no wheel is asked to turn 150 ms later."""

import pytest

import hil
from hil.core.errors import HilError
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.robot.trajectories import line

AT_S, SOON_S, LOOK_NS = 1.5, 0.15, 1_000_000
CLIMB = line((0, 0, 0), (0.12, 0, 0), duration_s=2.4)
BUS = ("unplug", "brownout", "off", "baud_mismatch", "garbage", "truncate,probability=1")
ONE = ("off", "brownout", "garbage")
SILENCES = [("servos", kind) for kind in BUS] + [
    (f"servo.{s}", kind) for s in ("steer_BR", "drive_FL") for kind in ONE
]
QUICK = {("servos", "unplug"), ("servo.steer_BR", "off")}


def asked_to_turn(servo):
    """Whether a servo has power, torque and a goal that turns its wheel, and its watchdog is quiet."""
    asked = servo.table.get("torque_enable") and servo.table.get("goal_velocity")
    return not servo.dead and asked and not servo.axis.tripped


def resting_after_s(fault, seed):
    """Seconds from a fault until no wheel was asked to turn any more; whether one was when it struck."""
    with hil.open_bench("emulated", seed=seed, faults=[fault], overrides={"exit.look_after_s": 1.0}) as bench:
        (bus,) = [part for part in bench.world._parts if isinstance(part, ServoBus)]
        since_s, turning = AT_S - 0.01, []

        def look(t_ns):
            turning.extend([t_ns * 1e-9] if any(asked_to_turn(s) for s in bus.servos[:4]) else [])
            return t_ns + LOOK_NS

        bench.on_close(bench.clock.schedule(look, round(since_s * 1e9)))
        with pytest.raises(HilError):
            bench.drive(CLIMB, start_pose=(0, 0, 0))
        bench.look(0.3)
    return turning[-1] - AT_S, turning[0] < AT_S


@pytest.mark.parametrize(
    ("device", "kind"),
    [pytest.param(*case, marks=() if case in QUICK else pytest.mark.long) for case in SILENCES],
)
def test_whatever_silences_servos_no_wheel_is_asked_to_turn_for_long(device, kind):
    name, _, options = kind.partition(",")
    fault = f"{device}:{name}@{AT_S}" + (f",{options}" if options else "")
    late_s, turned = resting_after_s(fault, seed=3)
    assert turned
    assert late_s < SOON_S
