"""Several devices of one kind in a bench file: `[[rangefinder]]` with a `name` each.

Each becomes a table of its own, `rangefinder_front`: that is its name on the bench. Of a kind that `hil`
brings one has the kind's name: it is the bench's own, which its estimator and checks use.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from hil.core.errors import ConfigError
from hil.core.further_device import LABEL_RULE, FurtherKind, is_label
from hil.core.registry import base_of, kinds, may_be_twice
from hil.core.signals import KINDS

_ONCE = "there may be one: it moves the robot, or holds it on its surface, and the whole bench depends on it"


def spread(tree: Mapping[str, Any], origin: str) -> dict[str, Any]:
    """A parsed bench file with a table for each device, by its name on the bench.

    Args:
        tree: parsed bench file; where it has such tables already, they stay.
        origin: name of the file in errors.

    Raises:
        ConfigError: a name is missing, is none or is there twice, or a kind may be there once only.
    """
    found: dict[str, Any] = {}
    problems: list[str] = []
    for key, value in tree.items():
        for name, table in _devices(key, value, problems) if key in tuple(kinds()) else [(key, value)]:
            if name in found or (name != key and name in tree):
                problems.append(f"{key}: two devices would be called {name}; give one another name")
            found[name] = table
    if problems:
        raise ConfigError(f"{origin}: {len(problems)} problem(s)", problems=tuple(problems))
    return found


def _devices(key: str, value: Any, problems: list[str]) -> Iterator[tuple[str, Any]]:
    """Devices of one kind by their names on the bench; those that are wrong are left out and reported."""
    tables = value if isinstance(value, list) else [value]
    if not all(isinstance(table, Mapping) for table in tables) or not tables:
        if isinstance(value, list):
            problems.append(
                f"{key}: expected [{key}], or [[{key}]] for each of several (found {value!r:.60})"
            )
        else:
            yield key, value
        return
    if len(tables) > 1 and not may_be_twice(kinds()[key]):
        problems.append(f"{key}: found {len(tables)} of them; {_ONCE}")
        return
    labels = [table.get("name") for table in tables]
    for k, label in enumerate(labels):
        where = f"{key}[{k}].name" if isinstance(value, list) else f"{key}.name"
        if label is None and len(tables) > 1:
            problems.append(f'{where}: missing; each of several has one, for example name = "front"')
        elif label is not None and not is_label(label):
            problems.append(f"{where}: {label!r} is no name; expected {LABEL_RULE}")
        elif label is not None and labels.index(label) < k:
            problems.append(f"{where}: {label!r} is the name of another {key}, too; give one another name")
        else:
            name = _on_bench(key, labels, k)
            if name == key or _label_of(name) == label:
                yield name, tables[k]
            else:
                problems.append(f"{where}: {name} means another kind of device; choose another name")


def _on_bench(kind: str, labels: list[Any], k: int) -> str:
    """Name on the bench of the device of the k-th table."""
    label = labels[k]
    own = kind in KINDS and k == (labels.index(kind) if kind in labels else 0)
    return kind if own or label in (None, kind) or not may_be_twice(kinds()[kind]) else f"{kind}_{label}"


def _label_of(name: str) -> str | None:
    kind = kinds().get(name)
    return kind.label if isinstance(kind, FurtherKind) else None


def further_in(tree: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of further devices in a tree that is `spread`, also of those left out; by kind, in its order."""
    found = [
        name
        for name, table in tree.items()
        if (label := _label_of(str(name))) is not None
        and (table is None or (isinstance(table, Mapping) and table.get("name") == label))
    ]
    return tuple(name for kind in kinds() for name in found if base_of(name) == kind)


def devices_in(tree: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the devices that a tree, which is `spread`, has tables of."""
    further = further_in(tree)
    ordered = (n for kind in kinds() for n in (kind, *(f for f in further if base_of(f) == kind)))
    return tuple(name for name in ordered if isinstance(tree.get(name), Mapping))


def resolve_device(word: str, labels: Mapping[str, str | None]) -> str:
    """Find the device that a word names: by its name, by an alias, or by `KIND_NAME` of the bench's own.

    Args:
        word: name as a person types it.
        labels: `name` in the bench file of each device, by its name on the bench.

    Returns:
        Its name on the bench, or the word if it names no device.
    """
    if word in labels:
        return word
    for device, label in labels.items():
        kind = kinds()[device]
        if word in kind.aliases or (label and word in _said(kind.name, kind.aliases, label)):
            return device
    return word


def _said(name: str, aliases: Iterable[str], label: str) -> set[str]:
    return {f"{one}_{label}" for one in (name, *aliases)}
