"""One page of each kind, made as a user makes them, on runs of seconds."""

import json
from datetime import date, datetime, timedelta, timezone

import numpy as np

from hil.cli import main
from hil.config.loading import load_bench
from hil.config.robot_record import Figure, NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.report.commission_page import write_commission_page, write_robot_page

DRIVE = '''
"""A short line."""
from hil.procedure import Context, Measurement, procedure
from hil.procedure.tracking_errors import error_figure, path_figure, series
from hil.robot.trajectories import line


@procedure(
    name="short_line", needs=("servos", "mocap"),
    headline=lambda v: f"The robot ends {v['odometry.end']:.1f} mm off.",
    measurements=[
        Measurement("odometry.end", "mm", high=10.0, rationale="half a grid cell"),
        Measurement("odometry.way", "mm", low=400.0, rationale="too much to ask for"),
        *(Measurement(f"{k}.rate_{i}", "Hz", low=50.0) for k in ("imu", "servos") for i in range(4)),
        Measurement("reported", "deg"),
    ],
)
def run(ctx: Context) -> None:
    """Drive a few centimetres up and look where the robot ends."""
    with ctx.step("drive"):
        motion = ctx.bench.drive(line((0, 0, 0), (0.05, 0, 0), duration_s=1.5), feedback="ekf")
    ctx.measure("odometry.end", 1e3 * abs(float(motion.mocap[-1, 0]) - 0.05))
    ctx.measure("odometry.way", 50.0)
    ctx.measure("reported", 0.5)
    for kind in ("imu", "servos"):
        for i in range(4):
            ctx.measure(f"{kind}.rate_{i}", 99.0 + i)
    shown = {"ekf": series(motion)}
    ctx.figure(path_figure(shown), "Path", "From motion capture.")
    ctx.figure(error_figure(shown), "Errors", "Truth minus reference.")
    ctx.table("Ends", ["case", "end (mm)"], [["a line up the wall", 1.25]])
    ctx.note("A note.")
'''
WALL = {
    name: {
        case: {"end_m": end, "rmse_x_m": end / 2, "rmse_y_m": end / 3, "rmse_heading_rad": 0.01}
        for case in ("x_line", "y_line")
    }
    for name, end in {"nothing known": 0.03, "geometry": 0.012, "everything known": 0.002}.items()
}


def hil(*arguments):
    code = main([str(a) for a in arguments])
    assert code in (0, 1), arguments


def make_every_page(folder):
    """One page of each kind: its name and path."""
    script, pages = folder / "short_line.py", {}
    script.write_text(DRIVE)
    for seed in (1, 2):
        hil("run", script, "--bench", "emulated_floor", "--seed", seed, "--out", folder / f"run{seed}")
    pages["run"] = folder / "run1" / "report.html"
    hil("report", folder / "run1", folder / "run2", "--out", folder / "compare.html")
    pages["comparison"] = folder / "compare.html"
    (recording,) = (folder / "run1").glob("*.mcap")
    hil("replay", recording, "--page", folder / "replay.html")
    pages["replay"] = folder / "replay.html"
    pages |= _calibration(folder) | _campaigns(folder, script)
    pages["trends"] = _trends(folder / "history")
    pages["commissioning"], pages["robot"] = _commissioning(folder)
    bench = folder / "lab.toml"
    bench.write_text('schema = 1\nname = "lab"\n[servos]\nbackend = "emulated"\n')
    main(["accept", "--bench", str(bench), "--out", str(folder / "accept")])
    pages["acceptance"] = folder / "accept" / "accept.html"
    return pages


def _calibration(folder):
    hil("demo-data", folder / "data", "--repetitions", 2, "--seed", 1)
    hil(
        "calibrate", folder / "data", "--no-validation", "--out", folder / "c.toml", "--plots", folder / "fit"
    )
    hil("evaluate", folder / "data", "--calibration", folder / "c.toml", "--plots", folder / "errors")
    return {"calibration": folder / "fit" / "index.html", "evaluation": folder / "errors" / "index.html"}


def _campaigns(folder, script):
    for name, faults in (("one", ()), ("two", ("--fault", "tracker:off@0.5+0.5"))):
        hil(
            "campaign",
            script,
            "--bench",
            "emulated_floor",
            "--seeds",
            "1:3",
            "--workers",
            0,
            "--out",
            folder / name,
            *faults,
        )
    hil("report", folder / "one", folder / "two", "--out", folder / "campaigns.html")
    return {"campaign": folder / "one" / "campaign.html", "campaigns": folder / "campaigns.html"}


def _trends(root):
    noise = np.random.default_rng(1).normal(0.0, 0.1, 30)
    for day in range(30):
        value = 4.0 + 0.05 * max(0, day - 10) + noise[day]
        tree = {
            "schema": 1,
            "procedure": "gap",
            "verdict": "PASS",
            "bench": "lab",
            "virtual_time": False,
            "started": (datetime(2030, 3, 1, tzinfo=timezone.utc) + timedelta(days=day)).isoformat(),
            "calibration": {"path": "c.toml", "version": 1 + (day >= 10), "sha256": "ab" * 4},
            "measurements": [{"name": "width", "unit": "mm", "value": value, "high": 6.0, "outcome": "PASS"}],
        }
        (root / f"{day:02}").mkdir(parents=True)
        (root / f"{day:02}" / "result.json").write_text(json.dumps(tree))
    hil("results", "trends", "--in", root)
    return root / "trends.html"


def _commissioning(folder):
    record = RobotRecord(folder / "robot")
    zeros = {"alignment.steer_zero_rad": [0.01, -0.02, 0.03, -0.04]}
    facts = {"procedure": "steering_zero", "verdict": "PASS", "measured": "2030-01-01T10:00:00+00:00"}
    figures = {f"steer_{w}": Figure(value=0.01, sigma=0.001, unit="rad") for w in ("FL", "BL", "BR", "FR")}
    part = NewPart(Part(**facts, bench="lab", values=zeros, figures=figures))
    robot = identity(load_bench("emulated"))
    record.add({"zeros": part}, robot, created="2030-01-01T10:00:00+00:00", why="steering_zero")
    stages = [
        {"name": "bring_up", "verdict": "PASS", "seconds": 12.0, "folder": "01_bring_up"},
        {
            "name": "latency",
            "verdict": "FAIL",
            "seconds": 130.0,
            "folder": "02_latency",
            "why": "imu.age is 60 ms, at most 50 ms",
        },
    ]
    stopped = {"procedure": "latency", "verdict": "FAIL", "why": "imu.age", "do": "look at the cable"}
    reported = {
        "verdict": "FAIL",
        "robot": str(record.folder),
        "wall": WALL,
        "stages": stages,
        "stopped": stopped,
    }
    page = write_commission_page(folder, reported, "lab", "2030-01-01T12:00:00+00:00", 1)
    return page, write_robot_page(folder / "robot.html", record, date(2030, 1, 2))
