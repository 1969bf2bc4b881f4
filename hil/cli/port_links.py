"""Serial ports that a bench file names, as links to the terminals where `hil emulate` serves its devices."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from hil.config.bench import BenchConfig
from hil.core.errors import reason_of
from hil.core.registry import kinds

_OF_HARDWARE = Path("/dev")


class PortLinks:
    """Links from the names in a bench file to the terminals, whose own names change with every start.

    Args:
        config: the bench.
        endpoints: of its emulated devices, by the name they are shown as.
        of_hardware: whether names below `/dev` are linked as well, which is the place of real ports.
    """

    def __init__(
        self, config: BenchConfig, endpoints: Mapping[str, Mapping[str, Any]], *, of_hardware: bool = False
    ) -> None:
        self._made: dict[Path, str] = {}
        self._wanted = {}
        for name in config.emulated():
            table = config.devices()[name]
            served = endpoints.get(kinds()[name].shown_as, {}).get("port")
            port = getattr(table, "port", None) if "port" in table.model_fields_set else None
            if not isinstance(port, str) or not isinstance(served, str) or ":" in port:
                continue
            if of_hardware or not Path(port).absolute().is_relative_to(_OF_HARDWARE):
                self._wanted[name] = (Path(port), served)

    def make(self) -> list[str]:
        """Make them; returns one line for each that cannot be.

        What is there already is left alone, but for a link whose terminal has gone: its emulator was killed.
        """
        return [
            f"{name}: {path} {why}; served at {served}"
            for name, (path, served) in self._wanted.items()
            if (why := self._link(path, served))
        ]

    def _link(self, path: Path, served: str) -> str:
        if path.is_symlink() and not path.exists():
            with suppress(OSError):
                path.unlink()
        try:
            path.symlink_to(served)
        except FileExistsError:
            return "is there already and is left alone"
        except OSError as error:
            return f"cannot be made ({reason_of(error)})"
        self._made[path] = served
        return ""

    def remove(self) -> None:
        """Remove the links that were made, unless another program has replaced them."""
        for path, served in self._made.items():
            with suppress(OSError):
                if os.readlink(path) == served:
                    path.unlink()
        self._made.clear()
