"""Configurations that were recorded: read as they were, whatever would be refused today."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from hil.config.bench import BenchConfig, explained
from hil.config.values import RECORDED
from hil.errors import ConfigError


def recorded_bench(tree: Mapping[str, Any], origin: str) -> BenchConfig:
    """The configuration that a recording carries.

    Bounds and contradictions are for what is going to be driven; this has been driven.

    Args:
        tree: of its header.
        origin: what to name where it cannot be read.

    Raises:
        ConfigError: listing every problem with its dotted path.
    """
    try:
        return BenchConfig.model_validate(tree, context=RECORDED)
    except ValidationError as error:
        problems = explained(error)
    raise ConfigError(f"{origin}: {len(problems)} problem(s)", problems=tuple(problems))
