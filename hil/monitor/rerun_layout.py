"""Layout and colours of the Rerun window: the robot on the left, the operator's figures on the right."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from hil.core.registry import kinds
from hil.monitor.solid_geometry import Eye

Colour = tuple[int, int, int]

PATH_COLOURS: dict[str, Colour] = {
    "reference": (150, 150, 150),
    "truth": (60, 180, 75),
    "estimate": (0, 110, 230),
    "odometry": (245, 130, 48),
    "ekf": (145, 30, 180),
    "ukf": (0, 160, 160),
}
_COLOURS = "estimate blue, truth green, reference grey, odometry orange, EKF violet, UKF teal"
_ROBOT, _NEAR, _WALL = f"Robot: {_COLOURS}", "Near", "Flat (m)"
_BACKGROUND: Colour = (246, 248, 250)
SCENE, ROBOT = "scene", "scene/wall/estimate"
"""Root of what the three-dimensional views show, and the frame of the robot in it."""
LABELLED = ("slip", "loads")
"""Below `ROBOT`: arrows whose labels the view beside the robot shows; others show theirs when pointed at."""
TABS = ("Motion", "Servos", "Estimator", "Loop", "Health")
"""The tabs that every bench has; kinds of devices may add their own."""

_PALETTE: tuple[Colour, ...] = (
    (0, 110, 230),
    (245, 130, 48),
    (60, 180, 75),
    (200, 30, 70),
    (145, 30, 180),
    (0, 160, 160),
    (170, 110, 40),
    (90, 90, 90),
)
_BY_MEASUREMENT = {"wheels": 0, "gyro": 1, "tracker": 2, "gravity": 4, "mocap": 5}
_BY_DEVICE = (0, 6, 1, 2, 5)
"""Colours of measurements by name and of the first kinds of devices: one colour for what belongs together."""


class Sight(NamedTuple):
    """The part of the surface and of the robot in view.

    Attributes:
        x_range, y_range: ranges of the flat view, (right, down) in m.
        eye: camera of the view in three dimensions, in the scene.
        near: camera of the view beside the robot, in its body.
    """

    x_range: tuple[float, float]
    y_range: tuple[float, float]
    eye: Eye
    near: Eye


def line_colours(names: Sequence[str], before: int = 0) -> list[Colour]:
    """Colour per column; what belongs to one sensor has one colour, its gate a paler one.

    Args:
        names: names of the columns.
        before: columns of the same plot that have their colours already.
    """
    found, known = [], {**dict(zip(kinds(), _BY_DEVICE, strict=False)), **_BY_MEASUREMENT}
    for k, name in enumerate(names, before):
        sensor = next((s for s in known if s in name), None)
        colour = _PALETTE[(k if sensor is None else known[sensor]) % len(_PALETTE)]
        found.append(_paler(colour) if name.startswith("gate_") else colour)
    return found


def _paler(colour: Colour) -> Colour:
    red, green, blue = ((c + 255) // 2 for c in colour)
    return (red, green, blue)


def blueprint(sight: Sight | None = None, tab: str = TABS[0], further: Sequence[str] = ()) -> Any:
    """The layout; needs the `rerun` extra.

    Args:
        sight: part in view; everything that is drawn when None.
        tab: name of the front tab, one of `TABS`.
        further: names of further devices of a kind, which have plots of their own.
    """
    import rerun.blueprint as rrb

    log = rrb.TextLogView(origin="/events", name="Faults and events")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(rrb.Tabs(*_views_of_the_robot(sight), active_tab=0), log, row_shares=[5, 1]),
            rrb.Tabs(*_plots(further), active_tab=TABS.index(tab)),
            column_shares=[5, 4],
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed"),
    )


def _views_of_the_robot(sight: Sight | None) -> tuple[Any, ...]:
    """Views of the robot: in three dimensions, beside the robot, and flat."""
    import rerun as rr
    import rerun.blueprint as rrb

    def in_space(name: str, origin: str, eye: Eye | None, *labelled: str) -> Any:
        controls = None
        if eye is not None:
            controls = rrb.EyeControls3D(position=eye.place, look_target=eye.target, eye_up=eye.up)
        return rrb.Spatial3DView(
            origin=origin,
            contents=f"/{SCENE}/**",
            name=name,
            eye_controls=controls,
            background=_BACKGROUND,
            line_grid=rrb.LineGrid3D(visible=False),
            overrides={entity: [rr.Arrows3D.from_fields(show_labels=True)] for entity in labelled},
        )

    area, eye, near = None, None, None
    if sight is not None:
        area = rrb.VisualBounds2D(x_range=sight.x_range, y_range=sight.y_range)
        eye, near = sight.eye, sight.near
    robot = in_space(_ROBOT, f"/{SCENE}", eye)
    nearby = in_space(_NEAR, f"/{ROBOT}", near, *(f"/{ROBOT}/{arrows}" for arrows in LABELLED))
    return robot, nearby, rrb.Spatial2DView(origin="/wall", name=_WALL, visual_bounds=area)


def _plots(further: Sequence[str]) -> list[Any]:
    """The tabs of figures over time: those of every bench, then those that kinds of devices add."""
    import rerun.blueprint as rrb

    def plot(name: str, *entities: str) -> Any:
        return rrb.TimeSeriesView(origin="/", contents=[f"+ /{e}/**" for e in entities], name=name)

    drawn = [p for name in (*kinds(), *further) for p in kinds()[name].plots]

    def of_devices(tab: str) -> list[Any]:
        return [plot(p.title, p.entity) for p in drawn if p.tab == tab]

    views = {
        "Motion": [
            plot("Tracking error (m)", "state/tracking_error_m"),
            plot("Heading and its error (rad)", "state/heading_rad"),
            plot("Body twist (m/s, rad/s)", "state/twist"),
        ],
        "Servos": of_devices("Servos"),
        "Estimator": [
            plot("Normalised innovations and their gates", "innovations/normalised"),
            plot("Innovations (m, rad/s)", "innovations/raw"),
            plot("Rejected measurements", "estimator/rejected"),
            plot("Slip, sag, bias, scale", "estimator/states"),
        ],
        "Loop": [
            plot("Loop timing (ms)", "loop"),
            plot("Sensor ages (ms)", "ages"),
            plot("Cycles not shown", "monitor"),
        ],
        "Health": of_devices("Health"),
    }
    views |= {p.tab: of_devices(p.tab) for p in drawn if p.tab not in TABS}
    return [rrb.Vertical(*shown, name=name) for name, shown in views.items()]
