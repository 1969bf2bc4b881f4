"""What a run of each procedure showed, as the first sentence of its page, from its measured values."""

from __future__ import annotations

from collections.abc import Mapping

from hil.core.signals import WHEELS

_FILTERS = {"ekf": "the EKF", "ukf": "the UKF"}
_LINES = (("x_line", "Up the wall", "short", "shortfall"), ("y_line", "Across it", "too low", "sag"))
_CLEAR = 0.5
"""Of what a bring-up measures: below it something else moved, or hardly anything."""


def wall_tracking(v: Mapping[str, float]) -> str:
    """How far from its goal the robot ends by odometry and by the filters."""
    said = []
    for case, where, way, lost in _LINES:
        parts = []
        if f"{case}.odometry.{lost}" in v:
            parts.append(f"odometry ends {v[f'{case}.odometry.{lost}']:.0f} mm {way}")
        ends = {name: v.get(f"{case}.{key}.end") for key, name in _FILTERS.items()}
        parts += [f"{name} {end:.1f} mm from its goal" for name, end in ends.items() if end is not None]
        said += [f"{where}, {', '.join(parts)}."] if parts else []
    return " ".join(said)


def grid_scan(v: Mapping[str, float]) -> str:
    """How much of the wall was seen, and how far the robot strayed."""
    return (
        f"The scan saw {100.0 * v['covered']:.1f} % of its rectangle and ended {v['end']:.1f} mm from its "
        f"goal. Its RMSE is {v['rmse_x']:.1f} mm along X and {v['rmse_y']:.1f} mm along Y."
    )


def bring_up(v: Mapping[str, float]) -> str:
    """How many devices answered, and whether they go the right way."""
    reported = ("_response", ".straight", ".across")
    ways = {name: value for name, value in v.items() if name.endswith(reported)}
    turned = sum(value <= -_CLEAR for value in ways.values())
    unclear = sum(abs(value) < _CLEAR for value in ways.values())
    way = "whatever moved went the right way" if ways else "nothing was moved"
    if turned or unclear:
        both = ((turned, "reversed"), (unclear, "not as expected"))
        found = " and ".join(f"{count} {how}" for count, how in both if count)
        way = found.replace(" ", " of their directions are ", 1)
    return f"{v['devices']:.0f} kinds of device answered, and {way}."


def steering_zero(v: Mapping[str, float]) -> str:
    """How far the wheels stood from straight ahead, and how far they do now."""
    worst = max(abs(v[f"steer_{w}.zero"]) for w in WHEELS)
    return (
        f"The steering zeros were up to {worst:.2f} deg off. With the zeros that were found, the wheels "
        f"point ahead within {v['applied.worst_heading']:.2f} deg."
    )


def odometry_calibration(v: Mapping[str, float]) -> str:
    """What the calibration is worth on motions that it did not see."""
    return (
        f"The position error of odometry fell from {v['position_rmse_before']:.1f} mm to "
        f"{v['position_rmse_after']:.1f} mm (RMSE, driven anew with what was found)."
    )


def tracker_extrinsics(v: Mapping[str, float]) -> str:
    """Where the camera sits, and what knowing it brings."""
    return (
        f"The camera sits {v['mount_x']:.0f} mm ahead of the robot's middle and {v['mount_y']:.0f} mm to the "
        f"left. With its mount known, its position error fell from {v['before.position_rmse']:.1f} mm to "
        f"{v['applied.position_rmse']:.1f} mm (RMSE)."
    )


def adhesion_check(v: Mapping[str, float]) -> str:
    """What presses the robot on its wall, and how much more that is than it needs."""
    return (
        f"At its rated speed the fan presses with {v['rated_force']:.0f} N: {v['hold_margin']:.0f} N more "
        f"than this surface needs."
    )


def imu_calibration(v: Mapping[str, float]) -> str:
    """What is left of the gyro's offset, and how well gravity gives the heading."""
    return (
        f"With its offset stored, the gyro drifts by {abs(v['restored_bias']):.3f} deg/s. Gravity gives the "
        f"heading within {abs(v['corrected_heading']):.2f} deg."
    )


def latency(v: Mapping[str, float]) -> str:
    """From command to motion to knowledge."""
    known = {name.partition(".")[0]: t for name, t in v.items() if name.endswith(".command_to_known")}
    last = max(known, key=lambda name: known[name]) if known else ""
    message = f" The last to tell of it is {last}, after {known[last]:.0f} ms." if last else ""
    return f"The body moves {v['body.command_to_motion']:.0f} ms after its command.{message}"


def surface_identification(v: Mapping[str, float]) -> str:
    """What the robot loses on this wall."""
    return (
        f"On this surface the robot slips {v['slip_per_metre']:.0f} mm per metre up or down the wall, and "
        f"sags {v['sag_per_metre']:.0f} mm per metre across it."
    )


def wall_ablation(v: Mapping[str, float]) -> str:
    """What the record of the robot is worth at the end of its lines."""
    said = []
    for case, where, *_ in _LINES:
        if f"{case}.end" in v:
            before, after = v[f"{case}.nothing_known.end"], v[f"{case}.end"]
            said.append(
                f"{where}, the robot ends {after:.1f} mm from its goal; {before:.0f} with nothing known."
            )
    return " ".join(said)


def sensor_noise(v: Mapping[str, float]) -> str:
    """How noisy the sensors are in motion, and how sure a filter that knows it is."""
    parts = [
        f"{what} {v[name]:.2g} {unit}"
        for name, what, unit in (
            ("wheel_step_moving", "a wheel's step", "um"),
            ("gyro_moving", "the gyro", "mrad/s"),
            ("camera_position_moving", "the camera", "mm"),
        )
        if name in v
    ]
    nis = [value for name, value in v.items() if name.startswith("nis.")]
    sure = f" Mean NIS with these: {min(nis):.2f} to {max(nis):.2f}, 1 is ideal." if nis else ""
    return f"Noise in motion, one sigma: {', '.join(parts)}.{sure}"
