"""Options that select and configure the bench of a command; it receives them as one `BenchRequest`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli import start_question
from hil.cli.completion_types import BENCH, CONTROLLER, DEVICES, FAULT, SETTING
from hil.cli.options import FILE, SEED, FiniteRange
from hil.cli.question_answers import at_the_terminal, watching
from hil.core.known_names import HIGHEST_DOMAIN, LAWS

if TYPE_CHECKING:
    from hil.procedure.bench_source import BenchSource

_stated = partial(partial, click.option)
"""An option to which a command can still add its own help or default."""

_OPTIONS = {
    "bench": _stated(
        "--bench", type=BENCH, default="emulated", show_default=True, help="Bench file or profile name."
    ),
    "emulate": _stated(
        "--emulate", type=DEVICES, help="Devices to emulate: `all`, or names separated by commas."
    ),
    "settings": _stated(
        "--set",
        "settings",
        multiple=True,
        type=SETTING,
        metavar="KEY=VALUE",
        help="Parameter of the procedure, or `bench.KEY` of the bench file.",
    ),
    "seed": _stated("--seed", type=SEED, default=0, show_default=True, help="Seed of the emulated world."),
    "start_pose": _stated(
        "--start",
        "start_pose",
        metavar="X,Y,THETA",
        help="Where the robot stands if no motion capture sees it: m, m, rad (or 5deg) in the wall frame; "
        "an emulated robot is put there [default: environment.start_pose].",
    ),
    "realtime": _stated("--realtime", is_flag=True, help="Emulated devices at the wire, in real time."),
    "faults": _stated(
        "--fault",
        "faults",
        multiple=True,
        type=FAULT,
        metavar="SPEC",
        help="Fault, for example imu:stuck@2+3 (repeatable).",
    ),
    "inject_real": _stated(
        "--inject-real",
        is_flag=True,
        help="Inject faults of real devices at their links, as far as [faults] of the bench file permits.",
    ),
    "by_hand": _stated(
        "--by-hand",
        is_flag=True,
        help="Faults off, brownout and reset of real devices: you are asked at the terminal to switch power.",
    ),
    "calibration": _stated("--calibration", type=FILE, help="calibration.toml to apply."),
    "controller": _stated(
        "--controller",
        type=CONTROLLER,
        metavar="LAW|FILE.py:NAME|MODULE:NAME|ros2:TOPIC",
        help="Control law (nonlinear, optimal), a class of your own, or a program on ROS 2 that publishes "
        "JointState, Twist or TwistStamped, that drives every trajectory [default: control.law].",
    ),
    "ros2": _stated("--ros2", is_flag=True, help="Publish the bench as ROS 2 topics, on this computer only."),
    "ros2_domain": _stated(
        "--ros2-domain",
        type=click.IntRange(0, HIGHEST_DOMAIN),
        help="DDS domain of --ros2 [default: ROS_DOMAIN_ID, else 0].",
    ),
    "ros2_wait": _stated(
        "--ros2-wait",
        type=FiniteRange(0.0, 0.8),
        metavar="SHARE",
        help="Share of a cycle to wait for a controller on ROS 2, in real time "
        "[default: ros2.wait_share, 0.3].",
    ),
    "ros2_interface": _stated(
        "--ros2-interface",
        metavar="NAME",
        help="Network interface that --ros2 uses beside loopback: other computers see the bench.",
    ),
}


@dataclass(frozen=True)
class BenchRequest:
    """The bench options of a command line; an option that the command lacks has its default here.

    Attributes:
        bench: file or profile; empty where none was named and the command has no default.
        emulate: devices to emulate, `all`, or None for what the file says.
        settings: texts `KEY=VALUE`.
        seed: seed of the emulated world.
        start_pose: start pose of the robot, as text.
        realtime: emulated devices at the wire, in real time.
        faults: specs, and files of timelines.
        inject_real: True to inject faults of real devices at their links.
        by_hand: True to ask the operator for faults of the power of real devices.
        calibration: file to apply.
        controller: law, class of the user's own, or `ros2:` and a topic; empty for what the file says.
        ros2: True to publish as ROS 2 topics.
        ros2_domain: DDS domain; None for that of the environment.
        ros2_wait: share of a cycle to wait for a program that drives; None for what the file says.
        ros2_interface: network interface beside loopback; empty for none.
    """

    bench: str = ""
    emulate: str | None = None
    settings: tuple[str, ...] = ()
    seed: int = 0
    start_pose: str | None = None
    realtime: bool = False
    faults: tuple[str, ...] = ()
    inject_real: bool = False
    by_hand: bool = False
    calibration: Path | None = None
    controller: str = ""
    ros2: bool = False
    ros2_domain: int | None = None
    ros2_wait: float | None = None
    ros2_interface: str = ""

    @property
    def ros2_topic(self) -> str:
        """ROS 2 topic from which a program drives the robot; empty for none."""
        kind, _, topic = self.controller.partition(":")
        return topic or "/" if kind == "ros2" else ""

    def source(self, overrides: Mapping[str, object], *, otherwise: str = "") -> BenchSource:
        """The bench to open, with the sinks for a program that reads the progress.

        Args:
            overrides: keys of the bench file to values; `--start` overrides them.
            otherwise: bench to open if none was named.

        Raises:
            UsageError: `--start` is no pose, `--by-hand` without a terminal, or `--controller` is unknown.
            ConfigError: the controller of the user's own cannot be loaded.
        """
        from hil.faults.files import read_faults
        from hil.procedure.bench_source import BenchSource
        from hil.user_code.roles import CONTROLLER

        own = "" if self.controller in LAWS else self.controller
        if self.controller and not self.ros2_topic:
            CONTROLLER.check(self.controller)
            overrides = {**overrides, **({} if own else {"control.law": self.controller})}
        if self.ros2_wait is not None:
            overrides = {**overrides, "ros2.wait_share": self.ros2_wait}
        return BenchSource(
            self.bench or otherwise,
            emulate=self.emulate,
            seed=self.seed,
            realtime=self.realtime,
            faults=read_faults(self.faults),
            inject_real=self.inject_real,
            by_hand=at_the_terminal() if self.by_hand else None,
            overrides={**overrides, **start_question.start_override(self.start_pose)},
            calibration=self.calibration,
            controller=own,
            watch=watching(),
        )


def bench_options(*names: str, **otherwise: Mapping[str, Any]) -> Callable[[Callable[..., int]], Any]:
    """Decorate a command with bench options, in this order; it receives all of them as one `request`.

    Apply it several times to place bench options between a command's own options in its help.

    Args:
        names: fields of `BenchRequest`.
        otherwise: help or default of options that differ for this command, by name.
    """

    def decorate(function: Callable[..., int]) -> Any:
        @wraps(function)
        def called(*, request: BenchRequest = BenchRequest(), **given: Any) -> int:
            said = {name: value for name in names if (value := given.pop(name)) is not None}
            return function(request=replace(request, **said), **given)

        for name in reversed(names):
            called = _OPTIONS[name](**otherwise.get(name, {}))(called)
        return called

    return decorate
