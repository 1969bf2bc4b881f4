"""`hil demo-data`: write a data set of the six motions by a robot with hidden true parameters.

Without `--plant` recordings come from formulas (seconds). With it an emulated bench drives them in the
physics named: the same servos and cameras, wires and faults as in any other run (minutes).
"""

import itertools
import json
from pathlib import Path
from typing import Any

import click

from hil.cli.completion_types import FAULT
from hil.cli.nominal_robot_option import BENCH, configured, on_paper
from hil.cli.options import FILE, JSON, SEED
from hil.cli.progress import reporting

_CONTACTS = {"formulas": ("viscous", "coulomb", "elastic"), "own": (), "mujoco": ("creep", "holding")}
_FLOOR = "emulated_floor"
_TRUTH = "truth.json"
_RECORDINGS = (".csv", ".csv.gz", ".mcap", ".db3")


@click.command()
@click.argument("folder", type=FILE)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of robot and noise.")
@click.option("--repetitions", default=4, show_default=True, type=click.IntRange(1, 20))
@click.option(
    "--plant",
    type=click.Choice(["own", "mujoco"]),
    help="Drive an emulated bench in this physics instead of evaluating formulas.",
)
@click.option("--motions", help="Which motions, separated by commas [default: the six of the calibration].")
@click.option(
    "--contact",
    help="How wheels touch: viscous, coulomb or elastic in formulas; creep or holding in mujoco "
    "[default: the first of them].",
)
@click.option("--corrupt", help="Name of one recording to spoil, e.g. circle_cw_2 (formulas only).")
@click.option(
    "--fault", "faults", multiple=True, type=FAULT, help="Fault, e.g. mocap:drop@9+2 (--plant; repeatable)."
)
@BENCH
@JSON
def command(
    folder: Path,
    seed: int,
    repetitions: int,
    plant: str | None,
    motions: str | None,
    contact: str | None,
    corrupt: str | None,
    faults: tuple[str, ...],
    bench: str | None,
    as_json: bool,
) -> int:
    """Generate recordings (plain CSV) and, beside them, the hidden truth (truth.json).

    From formulas, a quarter of the recordings hold three slips of millimetres, a second each.

    FOLDER must hold no other recordings. The same command may be repeated there, except with --plant.

    Example: hil demo-data data --repetitions 2
    """
    from hil.core.errors import UsageError
    from hil.support.atomic_files import check_folder, staged, write_text

    world = plant or "formulas"
    chosen = _motions(world, motions)
    touch = _contact(world, contact)
    names = [f"{m}_{k}" for m in chosen for k in range(1, repetitions + 1)]
    if plant is None and faults:
        raise UsageError(f"--fault {faults[0]}: formulas have no devices", remedy="add --plant own or mujoco")
    if plant is not None and corrupt is not None:
        raise UsageError(f"--corrupt {corrupt}: not with --plant", remedy="use --fault, e.g. mocap:jump@20")
    if corrupt is not None and corrupt not in names:
        raise UsageError(f"--corrupt {corrupt}: no such recording", expected=", ".join(names[:3]) + ", ...")
    check_folder(folder)
    made = {_TRUTH, *(f"{name}.csv" for name in names)}
    _refuse(folder, sorted(_held(folder) - made if plant is None else _held(folder)))
    with staged(folder) as parts:
        if plant is None:
            truth = _from_formulas(parts, seed, repetitions, chosen, touch, corrupt, bench)
        else:
            truth = _from_a_bench(parts, seed, repetitions, chosen, (plant, touch), faults, bench or _FLOOR)
        write_text(parts / _TRUTH, json.dumps(truth, indent=1) + "\n")
        _refuse(folder, sorted(n for n in _held(folder) if not _same(folder / n, parts / n)))
    summary = {
        "folder": str(folder),
        "recordings": len(names),
        "seed": seed,
        "geometry": truth["nominal"],
        "plant": world,
        "contact": touch,
    }
    click.echo(json.dumps(summary) if as_json else f"{len(names)} recordings in {folder}")
    return 0


def _held(folder: Path) -> set[str]:
    """Names of files that new recordings would replace, or form one data set with."""
    if not folder.exists():
        return set()
    return {p.name for p in folder.iterdir() if p.name == _TRUTH or p.name.endswith(_RECORDINGS)}


def _same(old: Path, new: Path) -> bool:
    return old.is_file() and new.is_file() and old.read_bytes() == new.read_bytes()


def _refuse(folder: Path, names: list[str]) -> None:
    """Raise `DataError` for a folder that holds files of these names; nothing without names."""
    from hil.core.errors import DataError

    if names:
        others = f" and {len(names) - 1} more" if len(names) > 1 else ""
        raise DataError(
            str(folder),
            f"holds {names[0]}{others}, which the new recordings would replace or mix with",
            expected="a folder without recordings, or with those of the same command",
            remedy="choose another folder, or delete what it holds",
        )


def _motions(world: str, given: str | None) -> tuple[str, ...]:
    """The selected motions; raises `UsageError` for an unknown name."""
    from hil.calibration.synthetic import MOTIONS, OTHER_MOTIONS
    from hil.core.errors import UsageError, did_you_mean
    from hil.procedure.odometry_motions import OTHER_MOTIONS as DRIVEN

    if given is None:
        return MOTIONS
    known = (*MOTIONS, *(OTHER_MOTIONS if world == "formulas" else DRIVEN))
    for name in given.split(","):
        if name not in known:
            raise UsageError(
                f"--motions: {name!r} is unknown", expected=", ".join(known), remedy=did_you_mean(name, known)
            )
    return tuple(dict.fromkeys(given.split(",")))


def _contact(world: str, given: str | None) -> str | None:
    """Contact law of the wheels; raises `UsageError` if this physics does not have it."""
    from hil.core.errors import UsageError

    known = _CONTACTS[world]
    if given is not None and given not in known:
        raise UsageError(
            f"--contact {given}: not of {'the formulas' if world == 'formulas' else f'--plant {world}'}",
            expected=" or ".join(known) or "no --contact: the own plant has one law",
        )
    return given or (known[0] if known else None)


def _from_formulas(
    folder: Path,
    seed: int,
    repetitions: int,
    motions: tuple[str, ...],
    contact: str | None,
    corrupt: str | None,
    bench: str | None,
) -> dict[str, Any]:
    """Write recordings computed from formulas; returns the true parameters."""
    from hil.calibration.synthetic import hidden_robot, make_set
    from hil.datasets.plain_csv import write_plain

    nominal = on_paper(configured(bench))
    robot = hidden_robot(seed, contact=contact or "viscous", nominal=nominal)
    for recording in make_set(robot, seed, motions, repetitions=repetitions, corrupted=corrupt):
        write_plain(folder / f"{recording.name}.csv", recording)
    return {
        **robot.geometry.to_json(),
        "load": robot.load.tolist(),
        "contact": contact,
        "nominal": nominal.to_json(),
    }


def _from_a_bench(
    folder: Path,
    seed: int,
    repetitions: int,
    motions: tuple[str, ...],
    physics: tuple[str, str | None],
    faults: tuple[str, ...],
    bench: str,
) -> dict[str, Any]:
    """Drive the motions on an emulated bench, each repetition in a new world; returns the true parameters."""
    from hil.bench import hidden_truth, open_bench
    from hil.config.loading import load_bench
    from hil.procedure.odometry_motions import Repetition, Sizes, drive_repetition, unused

    plant, contact = physics
    varied = {"emulation.plant": plant, **({"emulation.contact": contact} if contact else {})}
    config = load_bench(bench, emulate="all", overrides={**unused(), **varied})
    truth: dict[str, Any] = {}
    made, wanted = itertools.count(1), repetitions * len(motions)
    with reporting() as report:
        report("recordings", 0, wanted)
        for number in range(1, repetitions + 1):
            with open_bench(config, seed=seed, faults=faults) as driven:
                assert driven.world is not None
                truth = hidden_truth(driven.world)
                repetition = Repetition(folder, motions, number, Sizes())
                drive_repetition(driven, repetition, lambda: report("recordings", next(made), wanted))
    return {**truth, "plant": plant, "contact": contact, "nominal": on_paper(config).to_json()}
