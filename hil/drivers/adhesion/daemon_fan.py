"""Base class of models of a fan that the fan daemon commands."""

from typing import ClassVar

from hil.core.device import Found, Search
from hil.drivers.serial_and_can_models import CanModel


class DaemonFan(CanModel):
    """A fan that the fan daemon commands; discovery skips it unless the model defines `search`."""

    emulation = "hil.fakes.adhesion.connection:emulated"
    dbc: ClassVar[str] = ""

    def search(self, search: Search) -> Found | None:
        """None: a query would make the asker a node of the bus."""
        return None

    @property
    def can_search(self) -> bool:
        """Whether the model defines `search`."""
        return type(self).search is not DaemonFan.search
