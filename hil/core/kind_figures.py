"""Figures of device kinds, guarded: a package whose `figures` fails is named once, and then left out."""

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

from hil.core.device import DeviceKind, Figures
from hil.core.signals import Inputs
from hil.core.third_party_errors import PackageError, call_in_package

LOG = logging.getLogger(__name__)

Limited = Callable[[str, str, str], AbstractContextManager[None]]


def unlimited(kind: str, package: str, what: str) -> AbstractContextManager[None]:
    """No limit: for calls outside of a cycle."""
    return nullcontext()


def _listed(kind: DeviceKind, inputs: Inputs) -> Sequence[tuple[str, Figures]]:
    return tuple(kind.figures(inputs))


class KindFigures:
    """Calls `DeviceKind.figures`; a kind that has failed gives no figures from then on.

    Args:
        limited: function that makes the context of a call from kind, package and what is called: a time limit
            where the call is made within a cycle.
    """

    def __init__(self, limited: Limited = unlimited) -> None:
        self._limited, self._failed = limited, set[str]()

    def __call__(self, kind: DeviceKind, inputs: Inputs) -> Sequence[tuple[str, Figures]]:
        """The figures of a kind in these inputs, by entity."""
        if kind.name in self._failed:
            return ()
        try:
            with self._limited(kind.name, kind.package, "figures()"):
                return call_in_package(
                    kind.name, kind.package, "figures", lambda: tuple(kind.figures(inputs))
                )
        except PackageError as error:
            self._failed.add(kind.name)
            LOG.warning("%s", error)
            return ()
