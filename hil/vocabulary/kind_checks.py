"""Whether a kind or a model of devices that an installed package adds can work; one that can is added."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING

from hil.vocabulary.errors import ConfigError, did_you_mean
from hil.vocabulary.kind_names import NAME_RULE, after_clash, is_name

if TYPE_CHECKING:
    from hil.vocabulary.kinds import DeviceKind, DeviceModel


def add_kind(found: dict[str, DeviceKind], kind: DeviceKind, origin: str) -> None:
    """Add a kind that a package brings, and its models.

    Args:
        found: kinds by name so far.
        kind: the new one.
        origin: name and version of its package.

    Raises:
        ConfigError: it is there already, or cannot work.
    """
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
    if kind.actuates and not kind.holds:
        raise ConfigError(
            f"device package {origin}: the kind {kind.name} says that it moves the robot",
            expected="servos only: actuates=False, holds=True for what presses the robot on its surface, or "
            "a model of the kind servos",
        )
    named = {f.name for f in fields(kind.sample)} if is_dataclass(kind.sample) else set()
    if not {"stamp", "status"} <= named:
        raise ConfigError(
            f"device package {origin}: samples of the kind {kind.name} are {kind.sample!r}",
            expected="a dataclass with the fields stamp and status",
        )
    found[kind.name] = replace(kind, models=(), package=origin)
    for model in kind.models:
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
    if not callable(model.driver):
        raise ConfigError(
            f"device package {origin}: model {model.name} of {model.kind} has no driver",
            expected="driver: a function of (config, clock)",
        )
    if isinstance(model.imperfections, type):
        raise ConfigError(
            f"device package {origin}: imperfections of model {model.name} of {model.kind} are the class "
            f"{model.imperfections.__name__} itself",
            expected=f"a function that gives it: imperfections=lambda: {model.imperfections.__name__}",
        )
    key = getattr(model.config, "model_fields", {}).get("model")
    if getattr(key, "default", None) != model.name:
        raise ConfigError(
            f"device package {origin}: the table of model {model.name} has no key for its own name",
            expected=f'model: Literal["{model.name}"] = "{model.name}" in its DeviceConfig',
        )
    found[kind.name] = replace(kind, models=(*kind.models, replace(model, package=origin)))
