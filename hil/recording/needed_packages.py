"""Finds the packages that a recording needs: those that add the kinds and models of its devices."""

from collections.abc import Mapping
from typing import Any

from hil.core.device import DeviceKind
from hil.core.errors import ConfigError
from hil.core.registry import further, kinds
from hil.core.signals import KINDS


def recorded_kinds(header: Mapping[str, Any]) -> tuple[DeviceKind, ...]:
    """Kinds whose samples a recording holds: all of ours, and those of other packages that its bench has."""
    present = [name for name, table in header.get("config", {}).items() if table is not None]
    own = (name for name in kinds() if name in KINDS or name in present)
    return tuple(kinds()[name] for name in (*own, *further(present)))


def needed_packages(header: Mapping[str, Any]) -> dict[str, str]:
    """Packages without which a recording cannot be read, by kind, or `KIND.MODEL` where they add a model."""
    found = {}
    for name, table in header.get("config", {}).items():
        kind = kinds().get(name)
        if kind is not None and isinstance(table, Mapping):
            model = next((m for m in kind.models if m.name == table.get("model")), kind.models[0])
            if name not in KINDS:
                found[name] = kind.package
            if model.package != kind.package:
                found[f"{name}.{model.name}"] = model.package
    return found


def added_kinds(packages: Mapping[str, Any]) -> tuple[DeviceKind, ...]:
    """The kinds of other packages whose samples a recording holds.

    Args:
        packages: packages that `needed_packages` gave when it was made.

    Raises:
        ConfigError: a package is not installed; it names all that are missing.
    """
    missing = {name: str(package) for name, package in packages.items() if not _is_known(name)}
    if missing:
        message = ", ".join(f"{name} ({package})" for name, package in missing.items())
        wanted = dict.fromkeys(package for package in missing.values() if package.split())
        raise ConfigError(
            f"the recording holds samples of devices that nothing here knows: {message}",
            expected="the package that adds each",
            remedy=f"install {', '.join(wanted)} from where you got it",
        )
    return tuple(kinds()[name] for name in packages if "." not in name and name not in KINDS)


def _is_known(name: str) -> bool:
    kind_name, _, model = name.partition(".")
    kind = kinds().get(kind_name)
    return kind is not None and (not model or any(m.name == model for m in kind.models))
