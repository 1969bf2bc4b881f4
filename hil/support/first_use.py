"""Names that a package offers and imports on first use, so that importing one of its modules stays quick."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def on_first_use(package: str, offered: Mapping[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a package.

    Args:
        package: name of the package.
        offered: module of every name, or `MODULE:NAME` if it is called otherwise there.
    """

    def find(name: str) -> Any:
        if name not in offered:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, other = offered[name].partition(":")
        return getattr(import_module(module), other or name)

    return find
