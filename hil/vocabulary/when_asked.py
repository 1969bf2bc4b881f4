"""Modules of other packages that are imported only when somebody looks into them."""

from __future__ import annotations

import sys
from importlib.util import LazyLoader, find_spec, module_from_spec
from types import ModuleType


def import_when_asked(package: ModuleType, name: str) -> None:
    """Put off the import of a module that its package hands out to whoever asks for all of its names.

    Nothing changes for those who use it: looking into it imports it. Does nothing where it is imported
    already, and where there is no such module.

    Args:
        package: what the module belongs to.
        name: of the module in its package.
    """
    full_name = f"{package.__name__}.{name}"
    spec = None if full_name in sys.modules else find_spec(full_name)
    if spec is None or spec.loader is None:
        return
    spec.loader = LazyLoader(spec.loader)
    module = sys.modules[full_name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    setattr(package, name, module)
