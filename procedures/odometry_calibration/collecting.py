"""Collects the recordings of an odometry calibration: drives repetitions in separate worlds and processes."""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path

from hil.datasets.plain_csv import read_plain
from hil.datasets.wheel_log import Recording
from hil.procedure import Context
from hil.procedure.odometry_motions import Repetition, drive_repetition, unused
from hil.procedure.parallel_benches import DriveJob
from hil.procedure.worker_processes import Workers


def read_round(folder: Path, names: Sequence[str]) -> list[Recording]:
    """Read the recordings of a round, in order."""
    return [read_plain(folder / name) for name in names]


@dataclass(frozen=True)
class Collected:
    """Position of a round in the whole run, for progress.

    Attributes:
        title: text for the round, `round 2 of 2 to 4`.
        before: number of recordings of the earlier rounds.
        expected: expected number of recordings of the whole run.
    """

    title: str
    before: int
    expected: int


def collect(
    ctx: Context,
    label: str,
    repetitions: Sequence[Repetition],
    calibration: Path | None,
    workers: Workers,
    so_far: Collected,
) -> list[str]:
    """Drive repetitions, each in a checkpoint and a new world; in virtual time each in two worlds.

    Args:
        ctx: context of the run.
        label: label of the round, `round 2`.
        repetitions: repetitions to drive.
        calibration: parameters to drive with; None for those of the bench.
        workers: processes that drive, if there are several.
        so_far: position of the round in the run.

    Returns:
        File names in order; the same whatever the number of processes.
    """
    titles = {f"{label}, repetition {k}": r for k, r in enumerate(repetitions, start=1)}
    missing = [r for title, r in titles.items() if not ctx.finished(title)]
    names: list[str] = []
    recordings = sum(len(r.motions) for r in repetitions)

    def report() -> None:
        whole = (so_far.before + len(names), so_far.expected)
        ctx.progress(f"{so_far.title}, recording", len(names), recordings, whole)

    with ctx.step(label), closing(_driven(ctx, label, missing, calibration, workers)) as found:
        report()
        for title in titles:
            names += ctx.checkpoint(title, lambda: next(found))
            report()
    return names


def _driven(
    ctx: Context, label: str, repetitions: Sequence[Repetition], calibration: Path | None, workers: Workers
) -> Generator[list[str], None, None]:
    """Yield the file names of each repetition as soon as it is driven."""
    parts = [r.halves() if ctx.source.virtual else [r] for r in repetitions]
    with closing(_driven_parts(ctx, label, list(chain(*parts)), calibration, workers)) as driven:
        for repetition, of_it in zip(repetitions, parts, strict=True):
            for _ in of_it:
                next(driven)
            yield [repetition.file(motion) for motion in repetition.motions]


def _driven_parts(
    ctx: Context, label: str, parts: Sequence[Repetition], calibration: Path | None, workers: Workers
) -> Generator[None, None, None]:
    if workers.processes > 1 and ctx.source.virtual:
        source = ctx.source.changed(calibration=calibration, overrides=unused())
        yield from ctx.at_once(
            [DriveJob(source, partial(drive_repetition, repetition=r)) for r in parts], workers
        )
        return
    for part in parts:
        name = f"{label} {part.number}" + (f" part {part.part + 1}" if part.part else "")
        bench = ctx.reopen(name, calibration=calibration, overrides=unused())
        drive_repetition(bench, part)
        yield
