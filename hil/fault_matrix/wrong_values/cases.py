"""The cases of the campaign of wrong values: a key, what the file says, and what is true."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.bench.true_values import OF_NO_DEVICE
from hil.config.assumed_parameters import parameters_of
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.errors import UsageError, did_you_mean

WITHOUT_CELLS: Mapping[str, Any] = {"load_cells": None}
PROPELLERS_ON_VESC: Mapping[str, Any] = {**WITHOUT_CELLS, "thrust.model": "vesc"}
BENCHES: Mapping[str, Mapping[str, Any]] = {
    "": {},
    "no load cells": WITHOUT_CELLS,
    "propellers on VESCs, no load cells": PROPELLERS_ON_VESC,
    "no motion capture": {"mocap": None},
    "no IMU": {"imu": None},
}
"""Further benches on which the parameters of what is missing are looked at, too."""
_LOOKED_AT: Mapping[str, tuple[str, ...]] = {
    "": ("",),
    "no load cells": ("adhesion.", "thrust."),
    "propellers on VESCs, no load cells": ("thrust.",),
    "no motion capture": ("tracker.", "robot.wheel_radius_m", "servos."),
    "no IMU": ("environment.", "tracker.mount_rotation_wxyz"),
}


@dataclass(frozen=True)
class WrongValue:
    """One case.

    Attributes:
        key: dotted key of the bench file.
        said, true: value in the file, and the true one.
        bench: key of `BENCHES`.
        plant: physics model.
        seed: seed of the emulated world.
        option: option of the emulated device that is true in the place of the key; empty for the key itself.
    """

    key: str
    said: Any
    true: Any
    bench: str
    plant: str
    seed: int
    option: str = ""

    @property
    def name(self) -> str:
        """Name of the case in progress reports and failures."""
        where = ", ".join(filter(None, (self.plant, self.bench)))
        return f"{self.key} = {shown(self.said)} / {self.truly} ({where}, seed {self.seed})"

    @property
    def truly(self) -> str:
        """The true value in words, with the option that has it."""
        return f"{self.option} {shown(self.true)}".strip()

    def overrides(self) -> dict[str, Any]:
        """Dotted key -> value of the bench file with the wrong value, and hardware with the true one."""
        return {**right(self.bench, self.plant), self.key: self.said, **self._truth()}

    def _truth(self) -> dict[str, Any]:
        if self.key.partition(".")[0] == "alignment":  # wheels have no other true signs and zeros
            return {}
        if self.option:
            return {f"emulation.{self.key.partition('.')[0]}.{self.option}": self.true}
        return {f"emulation.{self.key}": self.true}


def right(bench: str, plant: str) -> dict[str, Any]:
    """Overrides of a bench without a wrong value."""
    return {"emulation.plant": plant, **BENCHES[bench]}


def tables_of(config: BenchConfig) -> dict[str, Any]:
    """Tables of a bench file that can have parameters, by name."""
    return {**{name: getattr(config, name) for name in (*OF_NO_DEVICE, "alignment")}, **config.devices()}


def cases_of(
    *, plants: Sequence[str], seeds: Sequence[int], quick: bool = False, only: str = ""
) -> tuple[WrongValue, ...]:
    """Return the cases.

    Args:
        plants: physics models.
        seeds: seeds of the worlds.
        quick: only the first mistake of each parameter of the whole bench.
        only: only this key, or the keys of this table.

    Raises:
        UsageError: no parameter has this key.
    """
    found = [case for plant in plants for seed in seeds for case in _cases(plant, seed, quick)]
    if only:
        keys = sorted({case.key for case in found})
        found = [case for case in found if only in (case.key, case.key.partition(".")[0])]
        if not found:
            raise UsageError(
                f"--only {only!r}: no parameter has this key",
                expected="one of " + ", ".join(keys),
                remedy=did_you_mean(only, keys),
            )
    return tuple(found)


def _cases(plant: str, seed: int, quick: bool) -> Iterator[WrongValue]:
    for bench in ("",) if quick else BENCHES:
        config = load_bench("emulated", overrides=right(bench, plant))
        for key, true, parameter in parameters_of(tables_of(config)):
            if key.startswith(_LOOKED_AT[bench]):
                for mistake in parameter.wrong[:1] if quick else parameter.wrong:
                    if (said := mistake(true)) != true:
                        yield WrongValue(key, said, true, bench, plant, seed)
                for option, truth in parameter.unlike[:1] if quick else parameter.unlike:
                    yield WrongValue(key, true, truth, bench, plant, seed, option)


def shown(value: Any) -> str:
    """A value as the file has it, numbers with three digits."""
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(shown, value)) + "]"
    return f"{value:.3g}" if isinstance(value, float) else json.dumps(value)
