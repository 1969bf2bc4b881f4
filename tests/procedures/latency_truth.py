"""What the delays of a latency run truly are, from the emulated devices and the body themselves.

Every device looks at the body at an instant that the emulation knows: exposures and samples by their own
clocks, fusion outputs and looks at the servos as they happen. The emulated body moves in steps of 1 ms, so
that what a look shows was true at the last step; a turn rate is the mean over that step.
"""

from contextlib import contextmanager

import numpy as np

from hil.bench import open_bench
from hil.core.clock import NS_PER_S
from hil.core.interfaces import Sink
from hil.core.signals import Status
from hil.fakes.encoders.as5045.chip import EncoderNode
from hil.fakes.imu.bno055.chip import Bno055Chip
from hil.fakes.mocap.natnet.chip import NatNetServer
from hil.fakes.plant.robot import STEP_NS
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.tracker.t265.chip import T265
from hil.procedure.sample_arrays import integrated
from hil.procedures.latency import body_signals, steer, steering_signals, turn, values_ms
from hil.procedures.latency.fit import fit_delay
from hil.robot.kinematics import forward

GRID_NS, VELOCITY_LAG_NS = 4_000_000, 50_000_000
HALF_STEP_MS = 0.5e-6 * STEP_NS


class Looker(Sink):
    """A sink that notes what the body does in every cycle, and when devices looked."""

    def __init__(self, bench):
        self.bench, self.rows, self.fused_ns, self.servo_ns = bench, [], [], []
        self.chip, self.node, self.camera, self.capture, bus = (
            next(p for p in bench.world._parts if isinstance(p, kind))
            for kind in (Bno055Chip, EncoderNode, T265, NatNetServer, ServoBus)
        )
        measure = bus._sensing.measure

        def measured():
            self.servo_ns.append(bench.world.now_ns)
            return measure()

        bus._sensing.measure = measured

    def write(self, record):
        truth = self.bench.truth()
        angle_rad = self.bench.world.plant.joints()[0]
        self.rows.append([truth.t_ns, truth.pose_body_in_wall[2], *angle_rad, *truth.steering_true_rad])
        newest = self.fused_ns[-1] if self.fused_ns else -1
        self.fused_ns += [t_ns for t_ns, _ in self.chip._history if t_ns > newest]

    def close(self):
        pass

    def looked_ns(self, name, stamps):
        """When the device looked at what it reports under these stamps."""
        t_ns = np.array([s.t_ns for s in stamps], dtype=np.int64)
        device_ns = np.array([s.device_ns or 0 for s in stamps], dtype=np.int64)
        if name == "tracker":
            return (1e-6 * device_ns - self.camera._epoch_ms) * 1e6 * self.camera._stretch
        if name == "mocap":
            return self.capture._started_ns + device_ns / self.capture._stretch
        if name == "encoders":
            return device_ns / self.node._rate_error
        if name == "imu":
            asked_ns = t_ns + 5_000_000
            fused_ns = np.array(self.fused_ns)
            return fused_ns[np.searchsorted(fused_ns, asked_ns, side="right") - 1]
        looks_ns = np.unique(self.servo_ns)
        return looks_ns[np.abs(looks_ns[:, None] - t_ns).argmin(axis=0)]

    def samples(self, name, motion):
        """(stamp, host time, look) of the samples that a fit uses, ns."""
        origin_ns = motion.records[0].inputs.t_ns
        found = [s for r in motion.records for s in getattr(r.inputs, name) if s.stamp.t_ns >= origin_ns]
        if name in ("imu", "tracker", "mocap"):
            found = [s for s in found if s.status is Status.OK]
        stamps = [s.stamp for s in found]
        host_ns = np.array([s.host_ns for s in stamps])
        return np.array([s.t_ns for s in stamps]), host_ns, self.looked_ns(name, stamps)


@contextmanager
def looked_at(seed, overrides):
    with open_bench("emulated", seed=seed, overrides=overrides) as bench:
        looker = Looker(bench)
        bench.add_sink(looker)
        yield bench, looker


def measured_and_true_ms(seed, p, overrides):
    """Values of the procedure and the truth, ms by name."""
    with looked_at(seed, overrides) as (bench, looker):
        turning, steering = turn(bench, p), steer(bench, p)
        command, body = body_signals(bench, turning, p)
        axis_command, axes = steering_signals(bench, steering, p)
    rows = np.array(looker.rows)
    ways = {
        "body": true_delay_ms(command, turning, rows[:, 0], rows[:, 1]),
        "wheels": true_delay_ms(command, turning, rows[:, 0], rolled(bench.geometry, rows)),
        "steering": true_delay_ms(axis_command, steering, rows[:, 0], summed(rows, slice(6, 10))),
        "axes": true_delay_ms(axis_command, steering, rows[:, 0], summed(rows, slice(10, 14))),
    }
    looks = {n: looker.samples(n, steering if n == "encoders" else turning) for n in ("mocap", *p.devices)}
    looks |= {"servos": looker.samples("servos", turning), "steering": looker.samples("servos", steering)}
    return values_ms(p, body, axes), truth_ms(p, ways, looks)


def truth_ms(p, ways, looks):
    """What an unerring procedure would say; see the head of this module about steps."""
    stamp = {n: 1e-6 * float((t - look).mean()) for n, (t, _, look) in looks.items()}
    age = {n: 1e-6 * float(np.median(host - look)) for n, (_, host, look) in looks.items()}
    old = {n: 1e-6 * float((look % STEP_NS).mean()) for n, (_, _, look) in looks.items()}
    old["imu"] += HALF_STEP_MS
    servo_ns = looks["servos"][2]
    lag_ns = VELOCITY_LAG_NS + (servo_ns // STEP_NS * STEP_NS - servo_ns // GRID_NS * GRID_NS).mean()
    true = {
        "body.command_to_motion": ways["body"] + old["mocap"],
        "wheels.command_to_motion": ways["wheels"] + old["servos"],
        "steering.command_to_motion": ways["steering"] + old["steering"],
        "servos.velocity_lag": 1e-6 * lag_ns,
    }
    for name in ("servos", "mocap", *p.devices):
        way = {"servos": "wheels", "encoders": "axes"}.get(name, "body")
        against = {"encoders": "steering", "servos": "servos"}.get(name, "mocap")
        extra = 0.0 if name in ("servos", "mocap") else old[name] - old[against]
        true[f"{name}.age"] = age[name] + extra
        true[f"{name}.command_to_known"] = ways[way] + age[name] + old[name]
        if name in p.devices:
            true[f"{name}.stamp_error"] = stamp[name] + extra
    return true


def true_delay_ms(command, motion, t_ns, way):
    """Mean delay of a way of the body itself."""
    t_s = (t_ns - motion.records[0].inputs.t_ns) / NS_PER_S
    during = (t_s >= 0.0) & (t_s <= motion.t_s[-1])
    return 1e3 * fit_delay(command, t_s[during], way[during]).delay_s


def rolled(geometry, rows):
    """Heading that the wheels' true angles mean."""
    steps = np.diff(rows[:, 2:6], axis=0, prepend=rows[:1, 2:6]) * geometry.radius_m
    return np.cumsum(forward(geometry, steps, rows[:, 6:10])[:, 2])


def summed(rows, columns):
    """Mean angle of the axes, summed over time."""
    return integrated(rows[:, 0] / NS_PER_S, rows[:, columns].mean(axis=1))
