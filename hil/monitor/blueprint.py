"""Layout of the Rerun window: the wall on the left, the figures an operator watches on the right."""

from __future__ import annotations

from typing import Any

PATH_COLOURS = {
    "reference": (150, 150, 150),
    "truth": (60, 180, 75),
    "estimate": (0, 110, 230),
    "odometry": (245, 130, 48),
    "ekf": (145, 30, 180),
    "ukf": (0, 160, 160),
}


def blueprint() -> Any:
    """The layout; needs the `rerun` extra."""
    import rerun.blueprint as rrb

    def plot(name: str, *entities: str) -> Any:
        return rrb.TimeSeriesView(origin="/", contents=[f"+ /{e}/**" for e in entities], name=name)

    wall = rrb.Spatial2DView(origin="/wall", name="Wall")
    log = rrb.TextLogView(origin="/events", name="Faults and events")
    motion = rrb.Vertical(
        plot("Tracking error (m)", "state/tracking_error_m"),
        plot("Heading and its error (rad)", "state/tracking_error_rad", "state/heading_rad"),
        plot("Body twist", "state/twist"),
        name="Motion",
    )
    servos = rrb.Vertical(
        plot("Servo angles (rad)", "servos/position_rad"),
        plot("Servo rates (rad/s)", "servos/velocity_rad_s"),
        plot("Motor currents (A)", "servos/current_a"),
        name="Servos",
    )
    health = rrb.Vertical(
        plot("Temperatures (C)", "servos/temperature_c"),
        plot("Voltages (V)", "servos/voltage_v"),
        name="Health",
    )
    estimator = rrb.Vertical(
        plot("Normalised innovations and gates", "innovations"),
        plot("Estimator", "estimator"),
        name="Estimator",
    )
    loop = rrb.Vertical(
        plot("Loop timing (ms)", "loop"),
        plot("Sensor ages (ms)", "ages"),
        plot("Cycles not shown", "monitor"),
        name="Loop",
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(wall, log, row_shares=[4, 1]),
            rrb.Tabs(motion, servos, estimator, loop, health),
            column_shares=[1, 1],
        ),
        collapse_panels=True,
    )
