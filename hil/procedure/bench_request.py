"""Which bench a procedure runs on, as data: can be opened again and again, and sent to another process."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.calibration.calibration_file import read_calibration
from hil.calibration.usability_check import check_usable
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.choices import ROS2
from hil.core.errors import UsageError
from hil.core.interfaces import CommandingSink, Sink
from hil.procedure.user_controllers import make_own

if TYPE_CHECKING:
    from hil.bench import Bench


@dataclass(frozen=True)
class BenchSource:
    """Arguments of `hil.bench.open_bench`, checked when the configuration is first asked for.

    Attributes:
        bench: file, profile name or configuration.
        emulate: devices to emulate, `all`, or None for what the file says.
        seed: of the emulated world.
        realtime: emulated devices at the wire, in real time.
        faults: fault specs.
        overrides: dotted key -> value.
        calibration: file to apply.
        controller: class of the user's own that drives every trajectory, `FILE.py:NAME` or `MODULE:NAME`, or
            `ros2:TOPIC` of a program, which `publish` then asks; empty for the law of bench and procedure.
        watch: sinks that every opening of it is shown to.
        publish: makes one more sink from a bench's header, for every opening in this process; None for none.
    """

    bench: str | Path | BenchConfig = "emulated"
    emulate: str | None = None
    seed: int = 0
    realtime: bool = False
    faults: tuple[str, ...] = ()
    overrides: Mapping[str, object] = field(default_factory=dict)
    calibration: Path | None = None
    controller: str = ""
    watch: tuple[Sink, ...] = field(default=(), compare=False)
    publish: Callable[[Mapping[str, Any]], Sink] | None = field(default=None, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """What another process gets: it does not publish."""
        return {**self.__dict__, "publish": None}

    @cached_property
    def config(self) -> BenchConfig:
        """The checked configuration, as the bench will run; raises `ConfigError`."""
        found = load_bench(self.bench, emulate=self.emulate, overrides=self.overrides, seed=self.seed)
        return found.settled(realtime=self.realtime)

    @property
    def virtual(self) -> bool:
        """Whether it runs in virtual time: everything emulated and nothing at the wire."""
        return not self.realtime and len(self.config.emulated()) == len(self.config.devices())

    @property
    def real(self) -> tuple[str, ...]:
        """Names of the devices that are real."""
        return tuple(n for n in self.config.devices() if n not in self.config.emulated())

    def check_faults(self) -> None:
        """Plan the emulated devices and hold the faults against them, before anything is opened.

        Raises:
            UsageError, ConfigError: a device that cannot be emulated like that, or a fault that cannot be
                read or that no device can produce.
        """
        from hil.bench import check_faults

        check_faults(self.config, self.faults)

    def with_its_faults(self) -> BenchSource:
        """The same bench with those faults only that name a device which it emulates.

        For a bench that devices were left out of: `check_faults` refuses the faults of these.
        """
        from hil.bench import faults_within

        kept = faults_within(self.config, self.faults)
        return replace(self, faults=kept, overrides={**self.overrides, "emulation.faults": []})

    def open(self, sinks: Sequence[Sink] = ()) -> Bench:
        """A bench, to be used as a context manager; nothing is opened before it is entered."""
        from hil.bench import open_bench

        bench = open_bench(
            self.bench,
            emulate=self.emulate,
            seed=self.seed,
            realtime=self.realtime,
            faults=self.faults,
            overrides=self.overrides,
            sinks=(*self.watch, *sinks),
            calibration=self.calibration,
        )
        try:
            self._attach(bench)
        except BaseException:
            bench.close()
            raise
        return bench

    @property
    def on_ros2(self) -> bool:
        """Whether a program on ROS 2 drives every trajectory."""
        return self.controller.startswith(ROS2)

    def _attach(self, bench: Bench) -> None:
        """What publishes it, and what drives it."""
        if self.controller and not self.on_ros2:
            bench.own_controller = partial(make_own, self.controller)
        sink = None if self.publish is None else self.publish(bench.header())
        if sink is not None:
            bench.add_sink(sink)
        if isinstance(sink, CommandingSink):
            bench.driven_by = (self.controller, sink)
        elif self.on_ros2:
            raise UsageError(
                f"--controller {self.controller} drives no bench that another process opens",
                remedy="open it in the process of the command, or leave --controller out",
            )

    def changed(
        self,
        *,
        seed: int | None = None,
        calibration: Path | None = None,
        overrides: Mapping[str, object] | None = None,
    ) -> BenchSource:
        """The same bench with another seed, another calibration or further overrides.

        Args:
            seed: of the world; None keeps it.
            calibration: file; None keeps it.
            overrides: keys of the bench file to values, on top of those there are.
        """
        return replace(
            self,
            seed=self.seed if seed is None else seed,
            calibration=self.calibration if calibration is None else calibration,
            overrides={**self.overrides, **(overrides or {})},
        )

    def describe_calibration(self) -> dict[str, Any] | None:
        """File, version, verdict and SHA-256 of the calibration in use; None without one.

        Raises:
            ConfigError: it cannot be read, was made for another robot, or failed.
        """
        path = self.calibration or (Path(self.config.calibration) if self.config.calibration else None)
        if path is None:
            return None
        file = read_calibration(path)
        check_usable(file, self.config, str(path))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        return {
            "path": str(path),
            "version": file.version,
            "created": file.created,
            "verdict": file.verdict,
            "sha256": digest,
        }

    def header(self) -> dict[str, Any]:
        """What results and recordings say about it."""
        return {
            "config": self.config.model_dump(mode="json", by_alias=True),
            "calibration": self.describe_calibration(),
            "seed": self.seed,
            "realtime": self.realtime,
            "faults": list(self.faults),
            **({"controller": self.controller} if self.controller else {}),
        }
