"""Registry of all device kinds and models: the shipped ones and those of installed packages.

The shipped kinds are packages of `hil.drivers`, named like the fields of `hil.core.signals.Inputs`; each has
its `DeviceKind` as `KIND` in `kind.py`. An installed package adds kinds, or models to a kind, by entry points
of the group `hil.devices`, each of which names a subclass of `DeviceKind` or of `DeviceModel`.
"""

import importlib
import keyword
import re
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from hil.core.call_chain import GROUP
from hil.core.device import DeviceKind, DeviceModel
from hil.core.errors import ConfigError, did_you_mean, nearest
from hil.core.further_device import FurtherKind, is_label
from hil.core.signals import KINDS, NO_KINDS, Inputs

NAME_RULE = (
    "lower case letters, digits and _ that starts with a letter and is none of all, plant, none, "
    f"{', '.join(NO_KINDS)}, or Python's words"
)
_NAME = re.compile("[a-z][a-z0-9_]*")
_TAKEN = ("all", "plant", "none", *NO_KINDS)
_OF_A_KIND = ("name", "noun", "sample", "models")
_OF_A_MODEL = ("kind", "name", "title", "config", "driver")
_OURS = "hil.drivers"
_EXPECTED = "a subclass of hil.devkit.DeviceKind or hil.devkit.DeviceModel"
_further = cache(FurtherKind)


def is_name(name: object) -> bool:
    """Whether a name is valid for a kind.

    `all` (`--emulate all`), `plant` (fault `plant:...`) and the fields of `Inputs` that are not kinds are
    reserved.
    """
    return (
        isinstance(name, str)
        and _NAME.fullmatch(name) is not None
        and name not in _TAKEN
        and not keyword.iskeyword(name)
    )


def after_clash(package: str, what: str) -> str:
    """Remedy for a name of a kind or model that is already in use.

    Args:
        package: package that uses the name already.
        what: `kind` or `model`.
    """
    if package == "hil":
        return f"give the {what} another name: this one is taken by the package hil"
    return f"uninstall one of the two packages, or give the {what} another name"


def add_kind(found: dict[str, DeviceKind], kind: DeviceKind, origin: str) -> None:
    """Add a kind of a package, and its models.

    Args:
        found: kinds by name so far.
        kind: the new one.
        origin: name and version of its package.

    Raises:
        ConfigError: it is there already, or cannot work.
    """
    _complete(kind, _OF_A_KIND, origin)
    if not all(map(is_name, (kind.name, *kind.aliases))) or not kind.models:
        also = f" and aliases {kind.aliases!r}" if kind.aliases else ""
        raise ConfigError(
            f"device package {origin}: kind {kind.name!r}{also} with {len(kind.models)} models",
            expected=f"a name of {NAME_RULE}, and at least one model",
        )
    taken = {name: k for k in found.values() for name in (k.name, *k.aliases)}
    for name in (kind.name, *kind.aliases):
        if name in taken:
            raise ConfigError(
                f"device package {origin}: the kind {name} exists already ({taken[name].package})",
                remedy=after_clash(taken[name].package, "kind"),
            )
    if kind.moves_robot and not kind.holds_robot:
        raise ConfigError(
            f"device package {origin}: the kind {kind.name} says that it moves the robot",
            expected="servos only: moves_robot = False, holds_robot = True for what presses the robot on its "
            "surface, or a model of the kind servos",
        )
    named = {f.name for f in fields(kind.sample)} if is_dataclass(kind.sample) else set()
    if not {"stamp", "status"} <= named:
        raise ConfigError(
            f"device package {origin}: samples of the kind {kind.name} are {kind.sample!r}",
            expected="a dataclass with the fields stamp and status",
        )
    added = copy(kind)
    added.models, added.package = (), origin
    found[kind.name] = added
    for model in kind.models:
        if not isinstance(model, DeviceModel):
            raise ConfigError(
                f"device package {origin}: the kind {kind.name} lists {model!r}",
                expected="instances of DeviceModel: models = (MyModel(),)",
            )
        if model.kind != kind.name:
            raise ConfigError(
                f"device package {origin}: the kind {kind.name} lists {model.name}, a model of {model.kind}"
            )
        add_model(found, model, origin)


def add_model(found: dict[str, DeviceKind], model: DeviceModel, origin: str) -> None:
    """Add a model to its kind.

    Args:
        found: kinds by name so far.
        model: the new one.
        origin: name and version of its package.

    Raises:
        ConfigError: it is there already, or cannot work.
    """
    _complete(model, _OF_A_MODEL, origin)
    kind = found.get(model.kind)
    if kind is None:
        raise ConfigError(
            f"device package {origin}: model {model.name} is of the kind {model.kind}, which does not exist",
            expected="one of " + ", ".join(found),
            remedy=did_you_mean(model.kind, found),
        )
    known = {m.name: m for m in kind.models}
    if model.name in known:
        raise ConfigError(
            f"device package {origin}: there is a model {model.name} of {kind.name} already "
            f"({known[model.name].package})",
            remedy=after_clash(known[model.name].package, "model"),
        )
    if ":" not in str(getattr(model, "driver", "")):
        raise ConfigError(
            f"device package {origin}: model {model.name} of {model.kind} has no driver",
            expected='driver = "package.module:Class"',
        )
    key = getattr(model.config, "model_fields", {}).get("model")
    if getattr(key, "default", None) != model.name:
        raise ConfigError(
            f"device package {origin}: the table of model {model.name} has no key for its own name",
            expected=f'model: Literal["{model.name}"] = "{model.name}" in its DeviceConfig',
        )
    grown, added = copy(kind), copy(model)
    added.package = origin
    grown.models = (*kind.models, added)
    found[kind.name] = grown


def _complete(item: DeviceKind | DeviceModel, names: tuple[str, ...], origin: str) -> None:
    """Raise `ConfigError` for required class attributes that a kind or model lacks."""
    missing = [name for name in names if not hasattr(item, name)]
    if missing:
        base = "DeviceKind" if isinstance(item, DeviceKind) else "DeviceModel"
        raise ConfigError(
            f"device package {origin}: {type(item).__name__} lacks {', '.join(missing)}",
            expected=f"class attributes {', '.join(names)} of every {base}",
        )


class Kinds(Mapping[str, DeviceKind]):
    """Kinds by name; `KIND_NAME` gives the kind object of a further device.

    Iteration does not list further devices, because their names are arbitrary. A kind that moves or holds the
    robot has no further devices.
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


def may_be_twice(kind: DeviceKind) -> bool:
    """Whether a bench may have several devices of a kind; not if the kind moves or holds the robot."""
    return not (kind.moves_robot or kind.holds_robot)


@cache
def kinds() -> Kinds:
    """All kinds by name, in the order in which they are opened and read: the shipped ones first.

    Raises:
        ConfigError: an installed package adds something that cannot be used.
    """
    found: dict[str, DeviceKind] = {}
    for name in KINDS:
        found[name] = importlib.import_module(f"{_OURS}.{name}.kind").KIND
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
    """The kind with this name or alias, or that of a further device; None if unknown."""
    return next((k for k in kinds().values() if name in (k.name, *k.aliases)), kinds().get(name))


def which_device(word: str, known: Iterable[str]) -> str:
    """Hint such as "did you mean tracker?" for a word close to a name or alias of a device; else empty.

    Args:
        word: the unknown word, for example `camera` or `trackr`.
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
    """Names of further devices among the device names of a bench."""
    return tuple(name for name in names if isinstance(kinds().get(name), FurtherKind))


def base_of(name: str) -> str:
    """Name of a device's kind, by the device's name."""
    kind = kinds()[name]
    return kind.of if isinstance(kind, FurtherKind) else name


def sample_names(inputs: Inputs) -> tuple[str, ...]:
    """Names under which `inputs` may hold samples: all kinds, and its further devices."""
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
