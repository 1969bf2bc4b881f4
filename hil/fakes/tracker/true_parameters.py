"""True imperfections of an emulated tracking camera: of the T265 and of that behind a MAVLink computer."""

from dataclasses import dataclass
from typing import Annotated

from hil.config.field_types import Within


@dataclass(frozen=True)
class TrackerTruthOptions:
    """True imperfections of one camera; individual values are drawn once per seed.

    A key without a range of its own has that of its suffix, such as `_m_s` (`hil.fakes.imperfection_bounds`).

    Attributes:
        scale: distance that the visual odometry sees over the true one, mean over cameras.
        scale_sigma: relative scale error of the visual odometry, standard deviation over cameras.
        session_scale_sigma, session: the scale differs from one session to the next, this much (one sigma);
            each `session` has its own.
        yaw_rate_sigma_rad_s: constant heading drift about gravity, standard deviation over cameras.
        yaw_walk_rad_sqrt_s: random walk of that heading.
        position_walk_m_sqrt_m: random walk of the position per square root of the travelled metre.
        position_noise_m, angle_noise_rad: white noise of a pose, per axis.
        velocity_noise_m_s, rate_noise_rad_s: white noise of the velocities.
        latency_s: exposure to host, the smallest.
        jitter_s: mean of the exponential jitter beside it.
        clock_ppm: error of the time stamps' clock, standard deviation over cameras.
        drop_probability: share of poses that USB loses.
        settle_s: time with confidence 0, then 1, then 2, before it is 3.
        fast_m_s, fast_rad_s, low_confidence_s: motion that lowers the confidence, and for how long.
        relocalisations_per_s, relocalisation_m: mean rate of spontaneous jumps, and how far.
        boot_s: silence after a reset.
        mount_position_m, mount_rotation_wxyz: camera (robot axes) in the body as it truly is; as the
            bench configures it when None.
        firmware: version that it reports.
    """

    scale: Annotated[float, Within(0.1, 10.0, "seen over true distance")] = 1.0
    scale_sigma: float = 0.005
    session_scale_sigma: float = 0.0
    session: Annotated[int, Within(0, 2**31 - 1, "a number of a session")] = 0
    yaw_rate_sigma_rad_s: float = 5e-5
    yaw_walk_rad_sqrt_s: float = 2e-4
    position_walk_m_sqrt_m: float = 0.002
    position_noise_m: float = 0.0003
    angle_noise_rad: float = 0.0005
    velocity_noise_m_s: float = 0.005
    rate_noise_rad_s: float = 0.005
    latency_s: float = 0.020
    jitter_s: float = 0.002
    clock_ppm: float = 20.0
    drop_probability: float = 0.001
    settle_s: tuple[float, float, float] = (0.05, 0.15, 0.5)
    fast_m_s: float = 1.0
    fast_rad_s: float = 2.5
    low_confidence_s: float = 0.5
    relocalisations_per_s: float = 0.0
    relocalisation_m: float = 0.1
    boot_s: float = 0.3
    mount_position_m: tuple[float, float, float] | None = None
    mount_rotation_wxyz: tuple[float, float, float, float] | None = None
    firmware: str = "0.2.0.951"


IDEAL = TrackerTruthOptions(
    scale_sigma=0.0,
    yaw_rate_sigma_rad_s=0.0,
    yaw_walk_rad_sqrt_s=0.0,
    position_walk_m_sqrt_m=0.0,
    position_noise_m=0.0,
    angle_noise_rad=0.0,
    velocity_noise_m_s=0.0,
    rate_noise_rad_s=0.0,
    jitter_s=0.0,
    clock_ppm=0.0,
    drop_probability=0.0,
    settle_s=(0.0, 0.0, 0.0),
)
"""A camera without errors: 20 ms late, otherwise true."""
