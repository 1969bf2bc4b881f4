"""Checks a kind or a model of devices that an installed package adds, and registers it."""

from __future__ import annotations

import keyword
import re
from copy import copy
from dataclasses import fields, is_dataclass

from hil.core.device import DeviceKind, DeviceModel
from hil.core.errors import ConfigError, did_you_mean
from hil.core.signals import NO_KINDS

NAME_RULE = (
    "lower case letters, digits and _ that starts with a letter and is none of all, plant, none, "
    f"{', '.join(NO_KINDS)}, or Python's words"
)
_NAME = re.compile("[a-z][a-z0-9_]*")
_TAKEN = ("all", "plant", "none", *NO_KINDS)


def is_name(name: object) -> bool:
    """Whether a kind may be called so.

    `--emulate all`, the fault `plant:...` and the fields of `Inputs` that are no kinds mean something else.
    """
    return (
        isinstance(name, str)
        and _NAME.fullmatch(name) is not None
        and name not in _TAKEN
        and not keyword.iskeyword(name)
    )


def after_clash(package: str, what: str) -> str:
    """What to do where the name of a kind or model is taken.

    Args:
        package: that has the name already.
        what: `kind` or `model`.
    """
    if package == "hil":
        return f"give the {what} another name: this one is taken by the package hil"
    return f"uninstall one of the two packages, or give the {what} another name"


_OF_A_KIND = ("name", "noun", "sample", "models")
_OF_A_MODEL = ("kind", "name", "title", "config", "driver")


def add_kind(found: dict[str, DeviceKind], kind: DeviceKind, origin: str) -> None:
    """Add a kind that a package brings, and its models.

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
                f"device package {origin}: the kind {name} is there already ({taken[name].package})",
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
            f"device package {origin}: model {model.name} is of the kind {model.kind}, which there is not",
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
    """Raise `ConfigError` for class attributes that every kind or model has to have."""
    missing = [name for name in names if not hasattr(item, name)]
    if missing:
        base = "DeviceKind" if isinstance(item, DeviceKind) else "DeviceModel"
        raise ConfigError(
            f"device package {origin}: {type(item).__name__} lacks {', '.join(missing)}",
            expected=f"class attributes {', '.join(names)} of every {base}",
        )
