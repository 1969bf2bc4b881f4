"""Robots that are broken on purpose, for `pytest --hil-blind-spots`: what is wrong, and does it matter?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from hil.core.registry import kinds
from hil.procedure.bench_request import BenchSource
from hil.procedure.faults import stands_for_itself

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig

AT_S = 1.0
"""When a fault begins, s of the world: after the devices were opened, before anything has moved far."""
_BORNE = ("drop", "corrupt", "truncate", "duplicate", "slow", "intermittent", "delayed")
_BORNE_OF_SENSORS = (*_BORNE, "reset", "jump")
"""What a bench is made to bear, of every device and of those that only sense: no test has to notice it."""
_HARMFUL_OPTIONS = {"scale": 0.9, "offset_m": 0.1, "rate_rad_s": 0.1}


@dataclass(frozen=True)
class Breakage:
    """One robot that is not as it should be.

    Attributes:
        name: in tables and for the choice on the command line.
        faults: fault specs.
        overrides: keys of the bench file to values.
        matters: whether a suite that does not notice it lets a robot on a wall come to harm.
    """

    name: str
    faults: tuple[str, ...] = ()
    overrides: Mapping[str, object] = field(default_factory=dict)
    matters: bool = True

    def of(self, source: BenchSource) -> BenchSource:
        """The same bench with this robot."""
        broken = source.changed(overrides=self.overrides)
        return replace(broken, faults=(*source.faults, *self.faults))


def breakages(source: BenchSource) -> list[Breakage]:
    """All that the emulated devices of a bench can have, and what a robot can have that they serve."""
    from hil.bench.emulation import supported_faults

    config = source.config
    declared = supported_faults(config)
    return [*_assembled(config), *_weaker(config), *_faulty(declared)]


def _faulty(declared: Mapping[str, Mapping[str, tuple[str, ...]]]) -> Iterator[Breakage]:
    for device in filter(stands_for_itself, declared):
        for kind, options in declared[device].items():
            spec = f"{device}:{kind}@{AT_S:g}"
            yield Breakage(f"{device}:{kind}", (spec,), matters=kind not in _borne(device))
            for option in (o for o in options if kind == "wrong" and o in _HARMFUL_OPTIONS):
                value = _HARMFUL_OPTIONS[option]
                yield Breakage(f"{device}:{kind},{option}={value:g}", (f"{spec},{option}={value:g}",))


def _borne(device: str) -> tuple[str, ...]:
    kind = kinds().get(device)
    return _BORNE if kind is None or kind.moves_robot or kind.holds_robot else _BORNE_OF_SENSORS


def _assembled(config: BenchConfig) -> Iterator[Breakage]:
    """Put together in another way than the bench file says."""
    if "servos" in config.emulated():
        yield Breakage("drive FL turns the other way", overrides=_sign(config, "drive"))
        yield Breakage("steering FL turns the other way", overrides=_sign(config, "steer"))
        yield Breakage("steering horn FL one tooth off", ("servo.steer_FL:jump,angle_rad=0.25",))
        yield Breakage(
            "wheels three times as far from their drawing", overrides={"emulation.geometry_share": 3.0}
        )
    turned = [0.9659258, 0.0, 0.0, 0.2588190]  # 30 degrees about the normal of the surface
    for kind in ("tracker", "imu"):
        if kind in config.emulated():
            yield Breakage(
                f"{kind} mounted 30 deg off", overrides={f"emulation.{kind}.mount_rotation_wxyz": turned}
            )


def _sign(config: BenchConfig, which: str) -> dict[str, object]:
    first, *others = getattr(config.alignment, f"{which}_sign")
    return {f"alignment.{which}_sign": [-first, *others]}


def _weaker(config: BenchConfig) -> Iterator[Breakage]:
    """Strength that has gone."""
    if config.environment.kind == "wall" and any(kinds()[name].holds_robot for name in config.emulated()):
        yield Breakage("the fan presses half as much", ("plant:adhesion_loss@1,factor=0.5",))
    if "servos" in config.emulated():
        yield Breakage("the battery is nearly empty", overrides={"emulation.servos.supply_v": 8.5})
