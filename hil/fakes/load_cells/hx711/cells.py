"""Two load cells on HX711 converters: true force of the fan in, counts out, with zero, drift and noise."""

from dataclasses import dataclass
from typing import Annotated

from hil.config.field_types import Within
from hil.config.load_cells import LoadCellsConfig
from hil.core.clock import NS_PER_S
from hil.fakes.world import World
from hil.faults.fault import Supported
from hil.faults.plan import DeviceFaults

CELL_FAULTS: Supported = {
    "off": (),
    "stuck": (),
    "garbage": (),
    "wrong": ("factor", "drift_n_s"),
    "slow": ("factor",),
    "delayed": ("delay_s",),
    "brownout": (),
    "reset": (),
    "jump": ("force_n",),
}
COUNTS = 1 << 23
DELAY_S = 0.1
_JUMP_N, _WRONG = 10.0, 1.5
_BOOT_NS = 400_000_000
_S_PER_MIN, _DRIFTS_S = 60.0, 600.0
_BLOCK = 256

Newton = Annotated[float, Within(0.0, 100.0, "N")]


@dataclass(frozen=True)
class LoadCellTruthOptions:
    """True imperfections; standard deviations of what is drawn from the world's seed.

    Attributes:
        noise_n: noise of a conversion, each cell.
        zero_sigma_n: deviation of each cell's zero from the bench file.
        drift_n_per_min: drift of the zero per minute, in the first ten minutes. It ends, as warming up and
            creep do: OIML R 60 allows load cells a fifth as much creep from the 20th to the 30th minute as in
            all 30.
        scale_sigma: relative error of each cell's scale.
        uneven_share: share of the load by which one cell has more than the other.
    """

    noise_n: Newton = 0.05
    zero_sigma_n: Newton = 0.2
    drift_n_per_min: Newton = 0.1
    scale_sigma: float = 0.005
    uneven_share: float = 0.05


class Cells:
    """Both load cells with their converters.

    Args:
        world: true force, seed and faults.
        config: scales and range.
        options: true imperfections.
        name: device name of its faults.
    """

    def __init__(
        self, world: World, config: LoadCellsConfig, options: LoadCellTruthOptions, name: str = "load_cells"
    ) -> None:
        self.name, self._world, self._config, self._options = name, world, config, options
        self._rng = world.rng(name)
        self.faults = DeviceFaults(world.faults, name, world.rng(f"{name}.faults"))
        self._zero_n = [z + e for z, e in zip(config.zero_n, self._draw(options.zero_sigma_n), strict=True)]
        self._drift_n_s = [d / _S_PER_MIN for d in self._draw(options.drift_n_per_min)]
        self._scale = [1.0 + e for e in self._draw(options.scale_sigma)]
        self._share = (0.5 + 0.5 * options.uneven_share, 0.5 - 0.5 * options.uneven_share)
        self._noise: list[list[float]] = []
        self._held: tuple[int, ...] | None = None
        self._jumped_n = 0.0
        self._dead = False
        self.booted_ns = 0

    def _draw(self, sigma: float) -> list[float]:
        return [float(v) for v in self._rng.normal(0.0, sigma, 2)] if sigma else [0.0, 0.0]

    def silent(self, t_ns: int) -> bool:
        """Apply faults of the supply; return whether nothing is sent now."""
        if self.faults.none:
            return False
        was_dead, self._dead = self._dead, any(self.faults.find(k, t_ns) for k in ("off", "brownout"))
        if (was_dead and not self._dead) or self.faults.first_activation("reset", t_ns):
            self.booted_ns = t_ns + _BOOT_NS
        return self._dead or t_ns < self.booted_ns

    def counts(self, t_ns: int) -> tuple[int, ...]:
        """Return the counts of one conversion of both cells."""
        true_n = self._world.plant.adhesion_n()
        if not self._noise:
            self._noise = self._rng.standard_normal((_BLOCK, 2)).tolist()
        noise = self._noise.pop()
        t_s, sigma = min(t_ns / NS_PER_S, _DRIFTS_S), self._options.noise_n
        cells = zip(self._scale, self._share, self._zero_n, self._drift_n_s, noise, strict=True)
        seen = [c * share * true_n + zero_n + drift * t_s + sigma * n for c, share, zero_n, drift, n in cells]
        if self.faults.none:
            return tuple(map(self._converted, seen, self._config.n_per_count))
        counts = tuple(map(self._converted, self._wrong(seen, t_ns), self._config.n_per_count))
        return self._spoilt(counts, t_ns)

    def _converted(self, force_n: float, n_per_count: float) -> int:
        top_n = self._config.largest_n
        if not -top_n <= force_n <= top_n:
            force_n = min(max(force_n, -top_n), top_n)
        raw = round(force_n / n_per_count)
        return raw if -COUNTS <= raw < COUNTS else min(max(raw, -COUNTS), COUNTS - 1)

    def _wrong(self, seen: list[float], t_ns: int) -> list[float]:
        """Apply faults of scale, drift or zero to the forces."""
        wrong = self.faults.find("wrong", t_ns)
        if wrong is not None:
            factor = 1.0 if "drift_n_s" in wrong.options else wrong.option("factor", _WRONG)
            drift_n = wrong.option("drift_n_s", 0.0) * (t_ns - wrong.start_ns) / NS_PER_S
            seen = [factor * force_n + 0.5 * drift_n for force_n in seen]
        if (jump := self.faults.first_activation("jump", t_ns)) is not None:
            self._jumped_n += jump.option("force_n", _JUMP_N)
        return [force_n + 0.5 * self._jumped_n for force_n in seen]

    def _spoilt(self, counts: tuple[int, ...], t_ns: int) -> tuple[int, ...]:
        if self.faults.find("stuck", t_ns) is None:
            self._held = None
        else:
            self._held = counts = self._held or counts
        if self.faults.find("garbage", t_ns) is not None:
            counts = tuple(int(v) for v in self._rng.integers(-COUNTS, COUNTS, 2))
        return counts
