"""The boundary to the emulated devices of other packages: what their parts of the world raise is named here.

A part acts while the caller waits: for another device, or for a robot to come to rest. What it raises must
not hit them. So a part that has failed is silent from then on, and why is left with the world: the driver of
the device raises it when it is read, and a server of emulated devices ends by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from hil.bench.third_party.call_timeout import with_time_limit
from hil.core.device import DeviceModel
from hil.core.errors import HilError
from hil.core.package_errors import OURS, PackageError, blamed
from hil.devices.emulated_device import Transport
from hil.fakes.world import NEVER_NS, Scheduled, World

_MOST_AT_ONCE = 10_000
"""Actions at one instant; the fastest chip has some dozens."""


@contextmanager
def parts_of(world: World, kind: str, model: DeviceModel) -> Iterator[None]:
    """Guard the parts that are added to a world meanwhile, where another package brings them."""
    if model.package != OURS:
        world.enclose = lambda part: ThirdPartyPart(world, kind, model, part)
    try:
        yield
    finally:
        world.enclose = None


def wrapped_transport(world: World, kind: str, model: DeviceModel, transport: Transport) -> Transport:
    """A transport; wrapped in a `ThirdPartyTransport` where another package brings its device."""
    return transport if model.package == OURS else ThirdPartyTransport(world, kind, model, transport)


class ThirdPartyPart(Scheduled):
    """A part of the world that another package brings, or that runs a chip of it.

    Args:
        world: where its failure is left.
        kind: of the device.
        model: what brings it.
        part: the package's.
    """

    def __init__(self, world: World, kind: str, model: DeviceModel, part: Scheduled) -> None:
        self._world, self._kind, self._model, self._part = world, kind, model, part
        self.alone = getattr(part, "alone", False)
        self._at_ns, self._acted = -1, 0

    @contextmanager
    def _contained(self, what: str) -> Iterator[None]:
        """Run code of the package; its failure is kept."""
        try:
            with blamed(self._kind, self._model.package, f"{what} of the emulated {self._model.name}"):
                yield
        except HilError as error:
            self._world.failures.setdefault(self._kind, error)
            self._part.broken = True

    @property
    def _failed(self) -> bool:
        return self._kind in self._world.failures

    def next_due_ns(self) -> int:
        """As the part says; never again once it has failed."""
        if not self._failed:
            with self._contained("next_due_ns()"):
                return self._part.next_due_ns()
        return NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Let the part act; one that always has something more to do at this instant would hold up time.

        Raises:
            PackageError: it always had something more to do.
        """
        self._acted = self._acted + 1 if t_ns == self._at_ns else 0
        self._at_ns = t_ns
        what = f"on_due() of the emulated {self._model.name}"
        with self._contained("on_due()"), with_time_limit(self._kind, self._model.package, what):
            if self._acted > _MOST_AT_ONCE:
                raise PackageError(
                    self._kind,
                    self._model.package,
                    f"{what} never gets beyond {t_ns} ns",
                    expected="next_due_ns() later than the time at which on_due() was called",
                )
            self._part.on_due(t_ns)


class ThirdPartyTransport(ThirdPartyPart, Transport):
    """The transport of a device of another package."""

    def __init__(self, world: World, kind: str, model: DeviceModel, transport: Transport) -> None:
        super().__init__(world, kind, model, transport)
        self._transport = transport

    def filenos(self) -> list[int]:
        """As of the transport; none once it has failed."""
        if not self._failed:
            with self._contained("filenos()"):
                return self._transport.filenos()
        return []

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Let the transport take what has arrived."""
        with self._contained("on_readable()"):
            self._transport.on_readable(fd, t_ns)

    def endpoint(self) -> Mapping[str, object]:
        """As of the transport; raises its failure."""
        with blamed(self._kind, self._model.package, "endpoint()"):
            return self._transport.endpoint()

    def close(self) -> None:
        """Let go; what that raises is kept."""
        with self._contained("close()"):
            self._transport.close()
