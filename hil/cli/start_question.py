"""Start pose of a real robot: from `--start`, or from a question at the terminal."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import click

from hil.core.errors import UsageError

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig

KEY = "environment.start_pose"
_FORM = "x,y,theta: m, m, rad in the wall frame (theta also as 5deg)"


def parse_start(text: str) -> tuple[float, float, float]:
    """Pose of a text `x,y,theta`; raises `UsageError` that names this form."""
    parts = [part.strip() for part in text.split(",")]
    try:
        x_m, y_m = map(float, parts[:-1])
        in_degrees = parts[-1].endswith("deg")
        theta = float(parts[-1].removesuffix("deg"))
        pose = (x_m, y_m, math.radians(theta) if in_degrees else theta)
        if not all(map(math.isfinite, pose)):
            raise ValueError
    except ValueError:
        raise UsageError(f"--start {text!r} is no pose", expected=_FORM) from None
    return pose


def start_override(given: str | None) -> dict[str, object]:
    """`--start` as an override of the bench file; empty without it."""
    return {} if given is None else {KEY: parse_start(given)}


def asked_start(config: BenchConfig) -> dict[str, object]:
    """The start pose as an override; asks at the terminal if it is unknown.

    Raises:
        ConfigError: it is unknown, and there is no terminal.
    """
    if sys.stdin.isatty() and not config.knows_start:
        question = f"{config.name}: where does the robot stand? ({_FORM})"
        return {KEY: click.prompt(question, value_proc=_answer, err=True)}
    config.must_know_start()
    return {}


def _answer(text: str) -> tuple[float, float, float]:
    try:
        return parse_start(text)
    except UsageError as error:
        raise click.BadParameter(str(error)) from None
