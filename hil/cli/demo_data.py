"""`hil demo-data`: write a data set of the six motions by a robot with hidden true parameters."""

from __future__ import annotations

import json
from pathlib import Path

import click

from hil.cli.options import SEED
from hil.cli.robots import BENCH, configured, on_paper


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of robot and noise.")
@click.option("--repetitions", default=4, show_default=True, type=click.IntRange(1, 20))
@click.option("--contact", type=click.Choice(["viscous", "coulomb"]), default="viscous", show_default=True)
@click.option("--corrupt", help="Name of one recording to spoil, e.g. circle_cw_2.")
@BENCH
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(
    folder: Path, seed: int, repetitions: int, contact: str, corrupt: str | None, bench: str | None,
    as_json: bool,
) -> int:  # fmt: skip
    """Generate recordings (plain CSV) and, beside them, the hidden truth (truth.json)."""
    from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
    from hil.recording.plain_csv import write_plain
    from hil.vocabulary.errors import UsageError
    from hil.vocabulary.files import check_folder, staged, write_text

    names = [f"{m}_{k}" for m in MOTIONS for k in range(1, repetitions + 1)]
    if corrupt is not None and corrupt not in names:
        raise UsageError(f"--corrupt {corrupt}: no such recording", expected=", ".join(names[:3]) + ", ...")
    check_folder(folder)
    nominal = on_paper(configured(bench))
    robot = hidden_robot(seed, contact=contact, nominal=nominal)
    recordings = make_set(robot, seed, repetitions=repetitions, corrupted=corrupt)
    truth = {
        "x_w_m": robot.geometry.x_m.tolist(),
        "y_w_m": robot.geometry.y_m.tolist(),
        "r_m": robot.geometry.radius_m.tolist(),
        "delta0_rad": robot.geometry.steering_zero_rad.tolist(),
        "load": robot.load.tolist(),
        "contact": contact,
        "nominal": nominal.to_json(),
    }
    with staged(folder) as parts:
        for recording in recordings:
            write_plain(parts / f"{recording.name}.csv", recording)
        write_text(parts / "truth.json", json.dumps(truth, indent=1) + "\n")
    summary = {
        "folder": str(folder), "recordings": len(recordings), "seed": seed, "geometry": nominal.to_json(),
    }  # fmt: skip
    click.echo(json.dumps(summary) if as_json else f"{len(recordings)} recordings in {folder}")
    return 0
