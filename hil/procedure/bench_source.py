"""Describes the bench of a procedure as data: it can be opened repeatedly and sent to another process."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.calibration.calibration_file import read_calibration
from hil.calibration.usability_check import check_usable
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.errors import UsageError
from hil.core.interfaces import CommandingSink, Sink
from hil.core.known_names import ROS2
from hil.faults.fault import Fault
from hil.user_code.roles import CONTROLLER

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.bench.by_hand import Hand
    from hil.robot.trajectories import Trajectory


@dataclass(frozen=True)
class BenchSource:
    """Arguments of `hil.bench.open_bench`, checked when `config` is first read.

    Attributes:
        bench: file, profile name or configuration.
        emulate: devices to emulate, `all`, or None for what the file says.
        seed: seed of the emulated world.
        realtime: True to emulate devices at wire level, in real time.
        faults: faults of its devices, in addition to those of the configuration.
        inject_real: True to inject faults of real devices at their links.
        by_hand: operator who does faults of the power of real devices; None for none.
        overrides: dotted key -> value.
        calibration: file to apply.
        controller: the user's own controller for every trajectory, `FILE.py:NAME` or `MODULE:NAME`, or
            `ros2:TOPIC` of a ROS 2 program (needs `publish`); empty for the law of bench and procedure.
        watch: functions, each of which makes a sink for every bench opened from this source.
        publish: function that makes one more sink from the header of a bench opened in this process; None for
            none.
    """

    bench: str | Path | BenchConfig = "emulated"
    emulate: str | None = None
    seed: int = 0
    realtime: bool = False
    faults: tuple[Fault, ...] = ()
    inject_real: bool = False
    by_hand: Hand | None = field(default=None, compare=False)
    overrides: Mapping[str, object] = field(default_factory=dict)
    calibration: Path | None = None
    controller: str = ""
    watch: tuple[Callable[[BenchConfig], Sink], ...] = field(default=(), compare=False)
    publish: Callable[[Mapping[str, Any]], Sink] | None = field(default=None, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle for another process, without `publish` and `by_hand`."""
        return {**self.__dict__, "publish": None, "by_hand": None}

    @cached_property
    def config(self) -> BenchConfig:
        """The checked configuration with which the bench will run; raises `ConfigError`."""
        found = load_bench(self.bench, emulate=self.emulate, overrides=self.overrides, seed=self.seed)
        return found.settled(realtime=self.realtime)

    @property
    def virtual(self) -> bool:
        """Whether the bench runs in virtual time: all devices are emulated, none at wire level."""
        return not self.realtime and len(self.config.emulated()) == len(self.config.devices())

    @property
    def real(self) -> tuple[str, ...]:
        """Names of the real devices."""
        return tuple(n for n in self.config.devices() if n not in self.config.emulated())

    def check_faults(self, planned: Iterable[Trajectory] = ()) -> None:
        """Check the faults against the devices before anything is opened.

        Args:
            planned: trajectories that are known beforehand; they are made only where faults limit the travel.

        Raises:
            UsageError, ConfigError: a device cannot be emulated as configured, no device supports a fault, or
                a trajectory leads too far for one.
        """
        from hil.bench import check_faults, check_travel

        by_hand = self.by_hand is not None
        faults = check_faults(self.config, self.faults, inject_real=self.inject_real, by_hand=by_hand)
        check_travel(self.config, faults, planned)

    def planned_faults(self) -> tuple[Fault, ...]:
        """All faults of the bench, those of the configuration first; raises as `check_faults`."""
        from hil.bench import planned_faults

        by_hand = self.by_hand is not None
        return planned_faults(self.config, self.faults, inject_real=self.inject_real, by_hand=by_hand)

    def with_its_faults(self) -> BenchSource:
        """Return the same bench with only the faults of devices that it has.

        For a bench from which devices were removed: `check_faults` would reject their faults.
        """
        from hil.bench import faults_within

        kept = faults_within(self.config, self.faults)
        return replace(self, faults=kept, overrides={**self.overrides, "emulation.faults": []})

    def open(self, sinks: Sequence[Sink] = ()) -> Bench:
        """Return a bench to use as a context manager; devices are opened when the context is entered."""
        from hil.bench import open_bench

        bench = open_bench(
            self.bench,
            emulate=self.emulate,
            seed=self.seed,
            realtime=self.realtime,
            faults=self.faults,
            inject_real=self.inject_real,
            by_hand=self.by_hand,
            overrides=self.overrides,
            sinks=(*(make(self.config) for make in self.watch), *sinks),
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
        """Attach the publishing sink and the controller to a bench."""
        if self.controller and not self.on_ros2:
            bench.own_controller = partial(CONTROLLER.make, self.controller)
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
        """Return the same bench with another seed, another calibration or further overrides.

        Args:
            seed: seed of the emulated world; None keeps the current one.
            calibration: calibration file; None keeps the current one.
            overrides: dotted keys of the bench file -> values, added to the current overrides.
        """
        return replace(
            self,
            seed=self.seed if seed is None else seed,
            calibration=self.calibration if calibration is None else calibration,
            overrides={**self.overrides, **(overrides or {})},
        )

    def describe_calibration(self) -> dict[str, Any] | None:
        """Return path, version, date, verdict and SHA-256 of the calibration in use; None without one.

        Raises:
            ConfigError: the file cannot be read, was made for another robot, or its validation failed.
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
        """Return the description of the bench for results and recordings."""
        return {
            "config": self.config.model_dump(mode="json", by_alias=True),
            "calibration": self.describe_calibration(),
            "seed": self.seed,
            "realtime": self.realtime,
            "faults": list(map(str, self.faults)),
            **({"controller": self.controller} if self.controller else {}),
        }
