"""What figures show whatever the data: extremes of long curves, ticks that can be read, ends of intervals."""

import json
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import hil
from hil.procedure.tracking_errors import path_figure, series
from hil.report.calibration_page import _parameters
from hil.report.hover_data import taken_out
from hil.report.page_figures import save_figure
from hil.report.path_history import PathHistory
from hil.report.plot_style import MOST_POINTS, kept_rows, new_figure, plain_log, style, thin
from hil.report.replay_page import _path
from hil.robot.trajectories import line

LONG = 25_003


def glitch(row, size, rows=LONG):
    values = np.sin(np.linspace(0.0, 6.0, rows))
    values[row] += size
    return values


def of_axes(figure, path):
    """The axes that can be read off a figure once it is saved."""
    return json.loads(taken_out(save_figure(figure, path).read_text())[1])["axes"]


@pytest.mark.parametrize(("row", "size"), [(0, 5000.0), (12_345, -5000.0), (LONG - 1, 5000.0)])
def test_a_curve_that_is_thinned_keeps_a_glitch_of_one_sample(row, size):
    t_s, values = np.arange(float(LONG)), glitch(row, size)
    shown_s, shown = thin(t_s, values)
    assert MOST_POINTS // 3 < len(shown) <= MOST_POINTS
    assert (shown.min(), shown.max()) == (values.min(), values.max())
    assert (shown_s[0], shown_s[-1], np.all(np.diff(shown_s) > 0)) == (t_s[0], t_s[-1], True)
    assert np.array_equal(values[shown_s.astype(int)], shown)


def test_a_path_that_is_thinned_keeps_its_extremes_on_both_sides_and_its_gaps():
    x, y = glitch(7001, 3.0), glitch(9001, -3.0)
    x[12_001] = y[12_001] = np.nan
    assert {7001, 9001, 12_001} <= set(kept_rows(x, y).tolist())
    assert len(thin(x, y)[0]) <= MOST_POINTS
    assert kept_rows(x[:MOST_POINTS]).tolist() == list(range(MOST_POINTS))


def test_the_series_of_a_motion_keep_its_largest_error():
    still = np.zeros((LONG, 3))
    mocap = still.copy()
    mocap[:, 0] = np.linspace(0.0, 40.0, LONG)
    reference, seen = mocap.copy(), mocap.copy()
    seen[12_345, 0] += 0.05
    motion = SimpleNamespace(
        t_s=np.arange(float(LONG)), reference=reference, truth=(seen, ""), estimate=mocap
    )
    found = series(motion)
    assert len(found["t"]) <= 2 * MOST_POINTS
    assert np.max(np.subtract(found["truth"][0], found["reference"][0])) == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize(("x_m", "y_m", "aspect"), [(0.2, 4.0, "auto"), (4.0, 0.02, "auto"), (4.0, 1.0, 1.0)])
def test_a_path_along_a_line_shows_what_it_does_sideways(x_m, y_m, aspect):
    turn = np.linspace(0.0, np.pi, 50)
    path = [(0.5 * x_m * np.cos(turn)).tolist(), (y_m * np.sin(turn)).tolist()]
    (axes,) = path_figure({"ekf": {"reference": path, "truth": path}}).axes
    assert axes.get_aspect() == aspect
    poses = np.column_stack([*path, turn])
    motion = SimpleNamespace(estimate=poses + 0.01)
    (axes,) = _path({"EKF": motion}, poses, on_wall=True).axes
    assert axes.get_aspect() == aspect
    assert _path({"EKF": motion}, np.full_like(poses, np.nan), on_wall=True).axes[0].get_aspect() == 1.0


RANGES = [(0.0, 0.02), (0.0, 1.2), (0.0, 5000.0), (3.0, 4.0)]


@pytest.mark.parametrize(("low", "high"), RANGES)
def test_ticks_of_a_logarithmic_axis_can_be_read_whatever_the_range(low, high):
    figure = new_figure(2.6, 1.8)
    axes = style(figure.add_subplot(), "time (s)", "error (mm)")
    axes.plot([0.0, 1.0], [low, high])
    plain_log(axes, linear_below=1.0)
    figure.canvas.draw()
    bottom, top = axes.get_ylim()
    labels = [t for t in axes.get_yticklabels() if bottom <= t.get_position()[1] <= top]
    assert len(labels) >= 2
    assert all(len(t.get_text()) <= 5 for t in labels), [t.get_text() for t in labels]
    boxes = [t.get_window_extent() for t in labels]
    assert all(above.y0 >= below.y0 + 0.6 * below.height for below, above in pairwise(boxes))
    assert (axes.get_yscale() == "linear") == (high <= 1.0)


def test_labels_along_a_narrow_axis_do_not_touch(tmp_path):
    figure = new_figure(5.2, 4.2)
    for k in range(1, 5):
        axes = style(figure.add_subplot(2, 2, k), "x (m)", "y (m)")
        axes.plot([-0.0213, 0.0006], [1.0, 0.0])
    save_figure(figure, tmp_path / "a.svg")
    for axes in figure.axes:
        low, high = axes.get_xlim()
        boxes = [t.get_window_extent() for t in axes.get_xticklabels() if low <= t.get_position()[0] <= high]
        assert len(boxes) >= 2
        assert all(right.x0 - left.x1 > 3.0 for left, right in pairwise(boxes))


def calibration(std, bounds=None):
    nominal = np.concatenate([np.full(8, 0.1125), np.full(4, 0.0254), np.zeros(4)])
    sizes = np.concatenate([nominal[:12], np.ones(4)])
    problem = SimpleNamespace(
        nominal=nominal,
        sizes=sizes,
        prior_std=0.01 * sizes,
        upper=nominal + 0.05 * sizes,
        setting=SimpleNamespace(bounds=bounds),
    )
    solution = SimpleNamespace(z=nominal + 0.012 * sizes)
    intervals = SimpleNamespace(quantile=2.5, std=std * sizes)
    return SimpleNamespace(fit=SimpleNamespace(problem=problem, solution=solution), intervals=intervals)


def test_intervals_of_parameters_end_inside_the_frame():
    drawn = _parameters(calibration(np.linspace(0.001, 0.02, 16)))
    (axes,) = drawn.figure.axes
    low, high = axes.get_ylim()
    ways = [path.vertices[:, 1] for c in axes.collections for path in c.get_paths()]
    assert len(ways) == 16
    assert all(low < way.min() < way.max() < high for way in ways)
    assert "1 is 1 %" in drawn.caption
    assert "how far off a part may be" in drawn.caption
    assert "Arrows" not in drawn.caption


@pytest.mark.parametrize("unknown", [7.0, np.nan])
def test_an_interval_without_an_end_in_the_frame_has_an_arrow_there(unknown):
    std = np.full(16, 0.002)
    std[5] = unknown
    drawn = _parameters(calibration(std, bounds=0.05))
    (axes,) = drawn.figure.axes
    low, high = axes.get_ylim()
    assert high < 50.0
    arrows = {line.get_marker(): line for line in axes.lines if line.get_marker() in (6, 7)}
    assert [arrows[m].get_xdata().tolist() for m in (6, 7)] == [[5], [5]]
    assert (arrows[6].get_ydata()[0], arrows[7].get_ydata()[0]) == (high, low)
    assert "Arrows: the interval goes on" in drawn.caption
    assert "how far the fit may go" in drawn.caption


def test_an_estimate_that_began_anywhere_is_not_drawn_beside_the_path():
    """The robot stands half a metre from the origin, is driven, and is only observed from there on."""
    history = PathHistory()
    with hil.open_bench("emulated_floor", overrides={"environment.start_pose": [0.4, 0.3, 0.0]}) as bench:
        for records in (
            bench.drive(line([0.4, 0.3, 0.0], [0.44, 0.3, 0.0], duration_s=2.0), hold_s=0.2).records,
            bench.observe(0.5, start_pose=[0.0, 0.0, 0.0]).records,
        ):
            assert abs(records[-1].truth["pose_body_in_wall"][0] - 0.44) < 0.01
            for record in records:
                history.write(record)
    unseen = PathHistory()
    for record in records:
        unseen.write(replace(record, truth=None, measurements=replace(record.measurements, mocap=())))
    assert unseen.figure() is None
    _, distances = history.figure().axes
    for drawn in distances.get_lines():
        apart_mm = np.array(drawn.get_ydata())
        assert np.isfinite(apart_mm).any()
        assert np.nanmax(apart_mm) < 50.0
