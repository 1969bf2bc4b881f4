"""The page of a procedure of one's own shows where the robot went, without being asked."""

import json

import pytest

from hil.procedure import procedure
from hil.procedure.bench_source import BenchSource
from hil.report.hover_data import taken_out
from hil.report.page_figures import themed_svg
from hil.report.plot_style import new_figure
from hil.robot.trajectories import line

FLOOR = BenchSource("emulated_floor", seed=1)


@procedure(name="climb", needs=("servos",))
def climb(ctx):
    """Four centimetres up, twice."""
    ctx.bench.drive(line((0, 0, 0), (0.04, 0, 0), duration_s=1.2))
    ctx.reopen()
    ctx.bench.drive(line((0, 0, 0), (0.04, 0, 0), duration_s=1.2))


@procedure(name="stand", needs=("servos",))
def stand(ctx):
    """Only stands there."""
    ctx.bench.settle(0.5)


@procedure(name="draws", needs=("servos",))
def draws(ctx):
    """Drives, and draws a figure of its own."""
    ctx.bench.drive(line((0, 0, 0), (0.04, 0, 0), duration_s=1.2))
    ctx.figure(new_figure(), "Own")


def figures(result):
    found = json.loads((result.folder / "result.json").read_text())["figures"]
    return {f["title"]: result.folder / f["path"] for f in found}


def test_a_driven_path_is_drawn_with_reference_estimate_and_truth(run_small):
    svg = figures(run_small(climb, source=FLOOR))["Path"]
    path, apart = json.loads(taken_out(themed_svg(svg))[1])["axes"]
    lines = {s["name"]: s for s in path["series"]}
    assert list(lines) == ["reference", "estimate", "truth"]
    for one in lines.values():
        up = [v for v in one["y"] if v is not None]
        assert (min(up), max(up)) == pytest.approx((0.0, 0.04), abs=2e-3)
    assert [s["name"] for s in apart["series"]] == ["truth to reference", "estimate to truth"]
    worst = max(v for s in apart["series"] for v in s["y"] if v is not None)
    assert 0.0 < worst < 5.0


@procedure(name="draws_it", needs=("servos",))
def draws_it(ctx):
    """Drives, and draws the path itself."""
    ctx.bench.drive(line((0, 0, 0), (0.04, 0, 0), duration_s=1.2))
    ctx.figure(new_figure(), "My path")


@pytest.mark.parametrize(("proc", "titles"), [(stand, []), (draws, ["Own", "Path"]), (draws_it, ["My path"])])
def test_figures_of_ones_own_add_to_it_and_there_is_none_where_nothing_was_driven(run_small, proc, titles):
    assert list(figures(run_small(proc, source=FLOOR))) == titles
