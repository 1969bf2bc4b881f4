"""The cases of a campaign: every combination of the varied settings, each with every seed."""

import hashlib
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hil.core.errors import UsageError

MOST_CASES = 100_000
LARGEST_SEED = 2**63 - 1
"""Tables hold seeds as integers of 64 bits."""
_LONGEST_NAME = 80


@dataclass(frozen=True)
class Axis:
    """One varied setting and its values."""

    key: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Case:
    """One run: a seed and the values of the varied settings."""

    seed: int
    settings: tuple[tuple[str, str], ...] = ()

    @property
    def group(self) -> str:
        """The varied settings as text: equal for cases that differ only in their seed."""
        return ", ".join(f"{key}={value}" for key, value in self.settings) or "all"

    @property
    def name(self) -> str:
        """Folder name that depends only on the case, so that a larger campaign finds finished runs."""
        text = f"seed={self.seed} " + " ".join(f"{k}={v}" for k, v in self.settings)
        name = re.sub(r"[^\w.+=-]+", "_", text).strip("_")
        if name == text.strip().replace(" ", "_") and len(name) <= _LONGEST_NAME:
            return name
        return f"{name[:_LONGEST_NAME]}_{hashlib.sha256(text.encode()).hexdigest()[:8]}"


_SEEDS = "0:10 for 0 to 9, or 1,4,7"


def parse_seeds(text: str) -> tuple[int, ...]:
    """Parse seeds: `0:10` (ten seeds, 0 to 9), `1,4,7`, or both mixed.

    Raises:
        UsageError: the text cannot be parsed, contains no seed, or names a seed twice.
    """
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?::(\d+))?\s*", part)
        if match is None:
            raise UsageError(f"--seeds {text!r} cannot be read", expected=_SEEDS)
        first = int(match[1])
        if match[2] is not None and int(match[2]) <= first:
            raise UsageError(f"--seeds {text!r}: no seed lies in {part.strip()}", expected=_SEEDS)
        if match[2] is not None and int(match[2]) - first > MOST_CASES:
            raise UsageError(f"--seeds {text!r} are too many", expected=f"at most {MOST_CASES}")
        seeds += range(first, int(match[2]) if match[2] is not None else first + 1)
        if seeds[-1] > LARGEST_SEED:
            raise UsageError(f"--seeds {text!r} are too large", expected=f"at most {LARGEST_SEED}")
    _check_named_once("--seeds", text, seeds)
    return tuple(seeds)


def _check_named_once(option: str, text: str, found: Sequence[object]) -> None:
    twice = next((value for value, n in Counter(found).items() if n > 1), None)
    if twice is not None:
        raise UsageError(f"{option} {text!r}: {twice} is named twice", remedy="name each value once")


def parse_axis(text: str) -> Axis:
    """Parse `key=a,b,c`. Commas in brackets do not split; `key=a;b` is split only at semicolons.

    Raises:
        UsageError: no key, no value, or a value named twice.
    """
    key, equals, rest = text.partition("=")
    separator = ";" if ";" in rest else ","
    values = tuple(v.strip() for v in _split(rest, separator) if v.strip())
    if not equals or not key.strip() or not values:
        raise UsageError(f"--vary {text!r} cannot be read", expected="key=value,value,...")
    _check_named_once("--vary", text, values)
    return Axis(key.strip(), values)


def _split(text: str, separator: str) -> list[str]:
    parts, depth, current = [], 0, ""
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        if character == separator and depth <= 0:
            parts.append(current)
            current = ""
        else:
            current += character
    return [*parts, current]


def expand(seeds: Sequence[int], axes: Sequence[Axis]) -> tuple[Case, ...]:
    """Return all cases, ordered by combination of settings, then by seed.

    Raises:
        UsageError: a setting is varied twice, or there are too many cases.
    """
    keys = [axis.key for axis in axes]
    twice = sorted({k for k in keys if keys.count(k) > 1})
    if twice:
        raise UsageError(f"--vary {twice[0]} is given twice", remedy="name all its values at once")
    total = len(seeds)
    for axis in axes:
        total *= len(axis.values)
    if total > MOST_CASES:
        raise UsageError(f"{total} cases are too many", expected=f"at most {MOST_CASES}")
    combinations = itertools.product(*([(axis.key, v) for v in axis.values] for axis in axes))
    return tuple(Case(seed, combination) for combination in combinations for seed in seeds)
