"""The cells of a fault campaign: which fault, when, and in which emulated world."""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.errors import UsageError, did_you_mean
from hil.fault_matrix.strengths import DEFAULT, strengths_of
from hil.faults.fault import Supported

DURATION_S = 2.4
"""Duration of the climb, s."""
BEGUN_S = 0.45
"""World time at which the devices of a shipped profile are open, s."""
MOMENTS: Mapping[str, str] = {
    "open": "@0.05",
    "motion": "@1.3",
    "stop": f"@{BEGUN_S + DURATION_S:g}",
    "second": "@1.3+1",
}
"""Start time of the fault at each moment; for one second, also its duration."""
PLANTS = ("own", "mujoco")
QUICK = (
    ("servos", "brownout", "second", DEFAULT),
    ("servos", "silent", "second", DEFAULT),
    ("servos", "drop", "motion", "probability=0.2"),
    ("servo.steer_FL", "jump", "motion", DEFAULT),
    ("tracker", "wrong", "motion", DEFAULT),
    ("imu", "corrupt", "motion", "probability=0.9"),
    ("plant", "adhesion_loss", "motion", DEFAULT),
    ("adhesion", "bus_off", "open", DEFAULT),
)
"""One cell for each known way to lose the hold of a robot or to mislead its estimate, a mild one (`drop`) and
a strong one (`corrupt`)."""
OTHERS_AT = "motion"
"""Moment of the strengths of a fault other than the first."""
_OF_EIGHT = re.compile(r"servo\.(?:\d+|drive_[^F].|steer_[^F].|\w+_FR)|encoder\.(?:BL|BR|FR)")
"""Devices that are represented by another device of the same kind."""
_MOST_FAULTS = 4


@dataclass(frozen=True)
class Cell:
    """One run.

    Attributes:
        device, fault: faulty device and kind of fault; several are joined by `+`.
        moment: key of `MOMENTS`, or `random`.
        seed: seed of the emulated world.
        plant: physics model.
        specs: fault specs in the format of `hil run --fault`.
        strength: options of the single fault, as `OPTION=NUMBER,...`; empty for its defaults.
    """

    device: str
    fault: str
    moment: str
    seed: int
    plant: str
    specs: tuple[str, ...]
    strength: str = DEFAULT

    @property
    def what(self) -> str:
        """Fault with its strength."""
        return ",".join(filter(None, (self.fault, self.strength)))

    @property
    def name(self) -> str:
        """Name of the cell in progress reports and failures."""
        return f"{self.device}:{self.what} {self.moment} seed {self.seed} {self.plant}"


def _cell(device: str, fault: str, moment: str, strength: str, seed: int, plant: str) -> Cell:
    spec = ",".join(filter(None, (f"{device}:{fault}{MOMENTS[moment]}", strength)))
    return Cell(device, fault, moment, seed, plant, (spec,), strength)


def is_tested_itself(device: str) -> bool:
    """Whether a device, by its fault name, is not represented by another servo or encoder."""
    return not _OF_EIGHT.fullmatch(device)


def cells_of(
    supported: Mapping[str, Supported],
    *,
    seeds: Sequence[int],
    plants: Sequence[str],
    moments: Sequence[str] = tuple(MOMENTS),
    only: Sequence[str] = (),
) -> tuple[Cell, ...]:
    """Return a cell for every fault of every device, at every moment, in every world.

    Further strengths of a fault (`strengths_of`) have a cell in motion. One servo and one encoder of each
    kind represent the eight servos and four encoders, unless `only` names another one.

    Args:
        supported: kinds of faults and their options, by device.
        seeds: seeds of the worlds.
        plants: physics models.
        moments: keys of `MOMENTS`.
        only: cells to restrict the campaign to: `DEVICE`, `DEVICE:FAULT` or `DEVICE:FAULT@MOMENT`.

    Raises:
        UsageError: `only` names a cell that does not exist.
    """
    pairs = [(device, fault) for device, faults in supported.items() for fault in faults]
    wanted = (
        list(_wanted(only, pairs, moments))
        if only
        else [(d, fault, moment) for d, fault in pairs if is_tested_itself(d) for moment in moments]
    )
    given = [
        (device, fault, moment, strength)
        for device, fault, moment in wanted
        for number, strength in enumerate(
            strengths_of(device, fault, supported[device][fault]) or ((DEFAULT,) if only else ())
        )
        if number == 0 or moment == OTHERS_AT
    ]
    return tuple(_cell(*one, seed, plant) for plant, seed, one in itertools.product(plants, seeds, given))


def _wanted(
    only: Sequence[str], pairs: Sequence[tuple[str, str]], moments: Sequence[str]
) -> Iterator[tuple[str, str, str]]:
    for text in only:
        name, _, moment = text.partition("@")
        device, _, kind = name.partition(":")
        found = [pair for pair in pairs if pair[0] == device and kind in ("", pair[1])]
        if not found or (moment and moment not in moments):
            names = [*{d for d, _ in pairs}, *(f"{d}:{k}" for d, k in pairs)]
            raise UsageError(
                f"--only {text!r}: there is no such cell",
                expected="DEVICE, DEVICE:FAULT or DEVICE:FAULT@MOMENT, with a moment of "
                + ", ".join(moments),
                remedy=did_you_mean(name, names) or "see docs/faults.md",
            )
        for device_name, fault in found:
            for each in (moment,) if moment else moments:
                yield device_name, fault, each


def quick_cells(
    supported: Mapping[str, Supported], *, seeds: Sequence[int], plants: Sequence[str]
) -> tuple[Cell, ...]:
    """Return the cells of the short form, a few in each world; arguments as for `cells_of`."""
    given = [one for one in QUICK if one[1] in supported.get(one[0], ())]
    return tuple(_cell(*one, seed, plant) for plant, seed, one in itertools.product(plants, seeds, given))


def random_cells(
    supported: Mapping[str, Supported], *, count: int, seeds: Sequence[int], plants: Sequence[str]
) -> tuple[Cell, ...]:
    """Return cells with one to four faults at random moments and strengths, reproducible from the arguments.

    Args:
        supported: kinds of faults and their options, by device.
        count: number of runs.
        seeds: seeds of the worlds, used in turn; the first also seeds the random choice.
        plants: physics models, used in turn.
    """
    rng = np.random.default_rng([count, *seeds])
    pairs = [(d, f) for d, faults in supported.items() for f in faults if not re.fullmatch(r"servo\.\d+", d)]
    cells = []
    for k in range(count):
        drawn = [
            pairs[i] for i in rng.choice(len(pairs), int(rng.integers(1, _MOST_FAULTS + 1)), replace=False)
        ]
        specs = []
        for device, fault in drawn:
            lasts = f"+{rng.uniform(0.05, 1.5):.2f}" if rng.random() < 0.6 else ""
            spec = f"{device}:{fault}@{rng.uniform(0.0, BEGUN_S + DURATION_S):.2f}{lasts}"
            strengths = strengths_of(device, fault, supported[device][fault]) or (DEFAULT,)
            specs.append(",".join(filter(None, (spec, strengths[int(rng.integers(len(strengths)))]))))
        cells.append(
            Cell(
                "+".join(d for d, _ in drawn),
                "+".join(f for _, f in drawn),
                "random",
                seeds[k % len(seeds)],
                plants[k % len(plants)],
                tuple(specs),
            )
        )
    return tuple(cells)
