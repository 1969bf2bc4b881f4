"""Runs a Python file of the user's as a module; its exceptions name that file.

As when Python runs it, its folder becomes the first entry of the module search path.
"""

import importlib
import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from hil.core.call_chain import place_of
from hil.core.errors import ConfigError, HilError, error_text


def run_file(path: Path) -> ModuleType:
    """Run the present text of a file as a module; `sys.modules` has it as `hil_script_` and its stem.

    Raises:
        ConfigError: names the file, and the line of a syntax error, or what it raised.
    """
    try:
        return _load(f"hil_script_{path.stem}", path)
    except HilError as error:
        raise ConfigError(f"{path}: {error}") from error
    except SyntaxError as error:
        raise ConfigError(f"{path}: line {error.lineno}: {error.msg}") from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a script may raise anything, `sys.exit()` too
        raise ConfigError(f"{path}: cannot be loaded: {error_text(error)} ({place_of(error)})") from error


class _AsItStands(SourceFileLoader):
    """Runs the present text of a file: cached bytecode of the last second may be of an older text."""

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def _load(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path, loader=_AsItStands(name, str(path)))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    look_for_modules_in(str(path.resolve().parent))
    spec.loader.exec_module(module)
    return module


def look_for_modules_in(folder: str) -> None:
    """Put a folder first in the module search path."""
    sys.path[:] = [folder, *(place for place in sys.path if place != folder)]
    importlib.invalidate_caches()  # a module may have been written since the folder was looked into
