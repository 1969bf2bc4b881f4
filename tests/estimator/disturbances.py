"""What happens to real streams, done to one recording's samples: each function gives a disturbed copy."""

from dataclasses import replace

import numpy as np

from hil.core.clock import NS_PER_S

BAD = float("nan")


def _middle_ns(s):
    return (s.begin_ns + s.end_ns) // 2


def _kept(samples, seed, share):
    chosen = np.random.default_rng(seed).random(len(samples)) < share
    return zip(samples, chosen.tolist(), strict=True)


def camera_jump(s):
    """The camera's frame jumps by 0.1 m half-way and stays there."""
    half = _middle_ns(s)
    step = np.array([0.1, 0.0, 0.0])
    return replace(
        s, tracker=tuple(replace(c, pose=c.pose + step) if c.stamp.t_ns > half else c for c in s.tracker)
    )


def camera_loss(s, seconds=5.0):
    """No camera for some seconds in the middle."""
    half, span = _middle_ns(s), round(0.5 * seconds * NS_PER_S)
    return replace(s, tracker=tuple(c for c in s.tracker if abs(c.stamp.t_ns - half) > span))


def not_finite(s):
    """One sample in fifty is NaN, in every stream."""
    return replace(
        s,
        wheels=tuple(
            replace(w, wheel_angle_rad=np.full(4, BAD)) if bad else w for w, bad in _kept(s.wheels, 1, 0.02)
        ),
        gyro=tuple(replace(g, yaw_rate_rad_s=BAD) if bad else g for g, bad in _kept(s.gyro, 2, 0.02)),
        tracker=tuple(
            replace(c, pose=np.array([BAD, 0.0, 0.0])) if bad else c for c, bad in _kept(s.tracker, 3, 0.02)
        ),
    )


def duplicates(s):
    """One sample in ten is delivered twice, in every stream."""

    def twice(samples, seed):
        return tuple(c for c, again in _kept(samples, seed, 0.1) for _ in range(2 if again else 1))

    return replace(s, wheels=twice(s.wheels, 1), gyro=twice(s.gyro, 2), tracker=twice(s.tracker, 3))


def _drifted(samples, begin_ns, end_ns, total_s):
    """Stamps of a clock that falls behind by `total_s` over the run; receive times stay true."""
    out = []
    for c in samples:
        behind = round(total_s * NS_PER_S * (c.stamp.t_ns - begin_ns) / (end_ns - begin_ns))
        out.append(replace(c, stamp=replace(c.stamp, t_ns=c.stamp.t_ns - behind)))
    return tuple(out)


def clock_drift(s, total_s=0.055):
    """Camera and inertial unit stamp with clocks that drift by 55 ms over the run."""
    span = (s.begin_ns, s.end_ns)
    return replace(s, gyro=_drifted(s.gyro, *span, total_s), tracker=_drifted(s.tracker, *span, total_s))


def gaps(s, length_s=0.2, every_s=4.0):
    """Every stream has a hole of 200 ms every four seconds, each at its own moment."""

    def holed(samples, phase_s):
        return tuple(c for c in samples if (c.stamp.t_ns / NS_PER_S + phase_s) % every_s > length_s)

    return replace(s, wheels=holed(s.wheels, 0.0), gyro=holed(s.gyro, 1.3), tracker=holed(s.tracker, 2.6))


ALL = {
    "camera jump of 0.1 m": camera_jump,
    "camera lost for 5 s": camera_loss,
    "NaN, 2 % of all samples": not_finite,
    "duplicates, 10 %": duplicates,
    "clocks drift by 55 ms": clock_drift,
    "gaps of 200 ms every 4 s": gaps,
}
