"""The page: tables from the figures, and a paragraph for everything in which the worlds disagree."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from two_worlds.bodies import TITLES, WORLDS
from two_worlds.results import Row

PAGE = Path(__file__).parents[1] / "two-worlds.md"
TEXT = Path(__file__).with_name("page.txt")
_CASES = {"x_line": "1.5 m up", "y_line": "1.5 m across"}
_MODELS = ("exact", "dry-friction", "creep")


def write(
    oracles: Sequence[Row], procedures: Sequence[Row], wall: Sequence[Row], calibration: Sequence[Row]
) -> None:
    """Write docs/two-worlds.md from page.txt, whose marks `<!-- NAME -->` are replaced by tables."""
    text = TEXT.read_text(encoding="utf-8")
    for name, table in (
        ("oracles", _oracles(oracles)),
        ("procedures", _procedures(procedures)),
        ("wall", _wall(wall)),
        ("odometry", _odometry(wall)),
        ("calibration", _calibration(calibration)),
        ("coverage", _coverage(calibration)),
    ):
        text = text.replace(f"<!-- {name} -->", "\n".join(table))
    PAGE.write_text(text, encoding="utf-8")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(cells)} |" for cells in lines]


def _oracles(rows: Sequence[Row]) -> list[str]:
    by_world = {row["world"]: row for row in rows}
    lines = [
        (
            "wheel loads: sum, moment, diagonal, % off statics",
            lambda r: " / ".join(f"{v:.2f}" for v in r["loads"]),
        ),
        (
            "adhesion at which it slides, of (1 - c) m g / mu: melamine, concrete",
            lambda r: " / ".join(f"{v:.2f}" for v in r["threshold"]),
        ),
        ("heading at which it slides (39 deg by statics)", lambda r: f"{r['heading_deg']:.1f} deg"),
        ("drift at rest on the wall", lambda r: f"{r['drift_um_s']:.2f} um/s"),
        ("steering four times by 90 deg at rest, floor", lambda r: f"{r['steering_mm']:.4f} mm"),
        (
            "3 m circle on the floor, robot against its wheels",
            lambda r: f"{r['circle'][0]:.2f} mm, {r['circle'][1]:.3f} deg",
        ),
        ("drives stop, 90 to 10 % (recorded: 72 ms)", lambda r: f"{r['stop_ms']:.0f} ms"),
        ("way lost upwards at 0.02, 0.05, 0.1 m/s", lambda r: " / ".join(f"{v:.1f} %" for v in r["up"])),
        ("sag across at 0.05 m/s", lambda r: f"{r['across'][1]:.0f} mm per metre"),
    ]
    cells = [[title, *(show(by_world[world]) for world in WORLDS)] for title, show in lines]
    return _table(["", *(TITLES[world] for world in WORLDS)], cells)


def _procedures(rows: Sequence[Row]) -> list[str]:
    found = {(r["procedure"], r["world"]): r for r in rows}
    names = dict.fromkeys(r["procedure"] for r in rows)
    cells = [[f"`{name}`", *(_verdict(found.get((name, world))) for world in WORLDS)] for name in names]
    return _table(["procedure", *(TITLES[world] for world in WORLDS)], cells)


def _verdict(row: Row | None) -> str:
    if row is None:
        return "not run"
    return "; ".join([row["verdict"], *row["failed"], *([row["error"]] if row["error"] else [])])


def _wall(rows: Sequence[Row]) -> list[str]:
    out = []
    for case, title in _CASES.items():
        for feedback in ("ekf", "ukf"):
            for world in WORLDS:
                own = [r for r in rows if (r["world"], r["case"], r["feedback"]) == (world, case, feedback)]
                if own:
                    out.append([title, feedback.upper(), TITLES[world], *_errors(own)])
    head = [
        "line",
        "feedback",
        "world",
        "seeds",
        "RMSE x (worst)",
        "RMSE y (worst)",
        "heading",
        "end, worst",
        "pose NEES",
    ]
    return _table(head, out)


def _errors(rows: Sequence[Row]) -> list[str]:
    x, y, heading = (np.array([r[k] for r in rows]) for k in ("rmse_x", "rmse_y", "rmse_heading"))
    end = max(float(np.hypot(r["end_x"], r["end_y"])) for r in rows)
    nees = np.array([r["nees"] for r in rows])
    return [
        str(len(rows)),
        f"{x.mean():.1f} ({x.max():.1f}) mm",
        f"{y.mean():.1f} ({y.max():.1f}) mm",
        f"{heading.mean():.2f} deg",
        f"{end:.1f} mm",
        f"{nees.mean():.1f} ({nees.min():.1f} to {nees.max():.1f})",
    ]


def _odometry(rows: Sequence[Row]) -> list[str]:
    out = []
    for case, title in _CASES.items():
        own = [r for r in rows if (r["world"], r["case"], r["feedback"]) == ("creep", case, "odometry")]
        ends = [np.array([r[k] for r in own]) for k in ("end_x", "end_y", "end_heading")]
        shown = [f"{v.mean():.0f} ({v.min():.0f} to {v.max():.0f}) mm" for v in ends[:2]]
        out.append([title, str(len(own)), *shown, f"{ends[2].mean():.1f} deg"])
    return _table(["line", "seeds", "end x", "end y", "heading"], out)


def _calibration(rows: Sequence[Row]) -> list[str]:
    out = []
    for world in WORLDS:
        own = [r for r in rows if r["world"] == world]
        for model in ("nominal", *_MODELS) if own else ():
            mm, deg = np.array([r[model] for r in own]).T
            better = np.array([r["nominal"][0] for r in own]) / mm
            out.append(
                [
                    TITLES[world],
                    model,
                    str(len(own)),
                    f"{mm.mean():.2f} ({mm.max():.2f}) mm",
                    f"{deg.mean():.2f} deg",
                    f"{np.count_nonzero(mm <= 4.0)} of {len(own)}",
                    "" if model == "nominal" else f"{better.min():.0f} times",
                ]
            )
    return _table(
        [
            "world",
            "forward model",
            "robots",
            "position (worst)",
            "heading",
            "at most 4 mm",
            "better by at least",
        ],
        out,
    )


def _coverage(rows: Sequence[Row]) -> list[str]:
    out = []
    for world in WORLDS:
        own = [r for r in rows if r["world"] == world]
        for model in _MODELS if own else ():
            inside = np.array([r[f"{model} covered"] for r in own])
            out.append([TITLES[world], model, *(f"{v:.2f}" for v in inside.mean(axis=0) / [16, 9])])
    return _table(["world", "forward model", "parameters", "twist correction"], out)
