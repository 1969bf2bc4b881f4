"""The registry of all kinds and models of devices, shipped and of installed packages.

The shipped kinds are packages of `hil.devices`, named like the fields of `hil.core.signals.Inputs`;
each has its `DeviceKind` as `KIND`. An installed package adds kinds, or models to a kind, by entry points
of the group `hil.devices`, each of which names a subclass of `DeviceKind` or of `DeviceModel`.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from hil.core.device import DeviceKind, DeviceModel
from hil.core.errors import ConfigError, nearest
from hil.core.further_device import FurtherKind, is_label
from hil.core.registry_checks import add_kind, add_model
from hil.core.signals import KINDS, Inputs

GROUP = "hil.devices"
_OURS = "hil.devices"
_EXPECTED = "a subclass of hil.devkit.DeviceKind or hil.devkit.DeviceModel"


class Kinds(Mapping[str, DeviceKind]):
    """Kinds by name; by `KIND_NAME` also what a further device of a kind is to the bench.

    Those cannot be listed: there are as many as names. A kind that moves or holds the robot has none.
    """

    def __init__(self, known: dict[str, DeviceKind]) -> None:
        self._known = known

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)

    def __getitem__(self, name: str) -> DeviceKind:
        if name in self._known:
            return self._known[name]
        of = max((k for k in self._known if str(name).startswith(f"{k}_")), key=len, default="")
        label = str(name).removeprefix(f"{of}_")
        if not of or not is_label(label) or not may_be_twice(self._known[of]):
            raise KeyError(name)
        return _further(self._known[of], label)


_further = cache(FurtherKind)


def may_be_twice(kind: DeviceKind) -> bool:
    """Whether a bench may have several devices of a kind: not of what moves or holds the robot."""
    return not (kind.moves_robot or kind.holds_robot)


@cache
def kinds() -> Kinds:
    """All kinds by name, in the order in which they are opened and read: the shipped ones first.

    Raises:
        ConfigError: an installed package adds something that cannot be used.
    """
    found: dict[str, DeviceKind] = {}
    for name in KINDS:
        found[name] = importlib.import_module(f"{_OURS}.{name}").KIND
    entries = sorted(entry_points(group=GROUP), key=lambda e: (e.value, e.name))
    items = [(item, _origin(entry)) for entry in entries for item in _loaded(entry)]
    for item, origin in items:
        if isinstance(item, DeviceKind):
            add_kind(found, item, origin)
    for item, origin in items:
        if isinstance(item, DeviceModel):
            add_model(found, item, origin)
    return Kinds(found)


def kind_of(name: str) -> DeviceKind | None:
    """The kind of a name or alias, or a further device's; None where there is none."""
    return next((k for k in kinds().values() if name in (k.name, *k.aliases)), kinds().get(name))


def which_device(word: str, known: Iterable[str]) -> str:
    """A question that names the device a word may mean, by what people call it; empty where none is near.

    Args:
        word: that is none of them, for example `camera` or `trackr`.
        known: names of devices, for example `tracker`.
    """
    known = tuple(known)
    called = {
        other.lower().replace(" ", "_"): kind.name
        for kind in kinds().values()
        if kind.name in known
        for other in (kind.noun, *kind.aliases)
    }
    said = called | {name.lower(): name for name in known}
    near = nearest(word, said)
    return f"did you mean {said[near]}?" if near else ""


def further(names: Iterable[str]) -> tuple[str, ...]:
    """Names of further devices among those of a bench."""
    return tuple(name for name in names if isinstance(kinds().get(name), FurtherKind))


def base_of(name: str) -> str:
    """Name of the kind that a device of a bench is of, by the device's name."""
    kind = kinds()[name]
    return kind.of if isinstance(kind, FurtherKind) else name


def heard_in(inputs: Inputs) -> tuple[str, ...]:
    """Names under which `inputs` may hold samples: all kinds, and further devices."""
    return (*kinds(), *further(inputs.added))


def added() -> tuple[DeviceKind, ...]:
    """The kinds that installed packages add."""
    return tuple(kind for name, kind in kinds().items() if name not in KINDS)


def _origin(entry: EntryPoint) -> str:
    return "an unnamed package" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def _loaded(entry: EntryPoint) -> tuple[DeviceKind | DeviceModel, ...]:
    origin = _origin(entry)
    try:
        item = entry.load()
        items = item if isinstance(item, tuple) else (item,)
        made = tuple(one() if isinstance(one, type) else one for one in items)
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"device package {origin}: {entry.value} cannot be loaded ({type(error).__name__}: {error})",
            expected=_EXPECTED,
            remedy=f"install what it needs or a version for this hil, or uninstall {origin.split()[0]}",
        ) from error
    for one in made:
        if not isinstance(one, (DeviceKind, DeviceModel)):
            raise ConfigError(
                f"device package {origin}: {entry.value} is a {type(one).__name__}", expected=_EXPECTED
            )
    return made
