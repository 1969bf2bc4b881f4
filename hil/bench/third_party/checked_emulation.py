"""The boundary to the emulated devices of other packages: keeps their exceptions, with the package's name.

A part of the world runs while the caller waits for another device, or for the robot to come to rest. Its
exception must not reach that caller. So a failed part is silent from then on, and its error is stored in the
world: the driver of the device raises it at the next read, and a server of emulated devices ends with it.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from hil.bench.third_party.call_timeout import with_time_limit
from hil.core.device import DeviceModel
from hil.core.errors import HilError
from hil.core.third_party_errors import OURS, PackageError, errors_as_package_error
from hil.fakes.emulated_device import Transport
from hil.fakes.world import NEVER_NS, Scheduled, World

_MOST_AT_ONCE = 10_000
"""Largest number of actions at one instant; the fastest chip has some dozens."""


@contextmanager
def parts_of(world: World, kind: str, model: DeviceModel) -> Iterator[None]:
    """Wrap all parts that are added to a world in the block, if another package provides the model."""
    if model.package != OURS:
        world.enclose = lambda part: ThirdPartyPart(world, kind, model, part)
    try:
        yield
    finally:
        world.enclose = None


def wrapped_transport(world: World, kind: str, model: DeviceModel, transport: Transport) -> Transport:
    """Wrap a transport in a `ThirdPartyTransport` if another package provides its model."""
    return transport if model.package == OURS else ThirdPartyTransport(world, kind, model, transport)


class ThirdPartyPart(Scheduled):
    """Wraps a part of the world that another package provides, or that runs a chip of that package.

    Args:
        world: world that stores its failure.
        kind: the device's kind.
        model: the device's model.
        part: the package's part.
    """

    def __init__(self, world: World, kind: str, model: DeviceModel, part: Scheduled) -> None:
        self._world, self._kind, self._model, self._part = world, kind, model, part
        self.alone = getattr(part, "alone", False)
        self._at_ns, self._acted = -1, 0

    @contextmanager
    def _contained(self, what: str) -> Iterator[None]:
        """Run code of the package; store its error in the world."""
        try:
            with errors_as_package_error(
                self._kind, self._model.package, f"{what} of the emulated {self._model.name}"
            ):
                yield
        except HilError as error:
            self._world.failures.setdefault(self._kind, error)
            self._part.broken = True

    @property
    def _failed(self) -> bool:
        return self._kind in self._world.failures

    def next_due_ns(self) -> int:
        """Next due time of the part; never if it has failed."""
        if not self._failed:
            with self._contained("next_due_ns()"):
                return self._part.next_due_ns()
        return NEVER_NS

    def on_due(self, t_ns: int) -> None:
        """Run the part. A part that is always due again at the same instant fails, as it would stop time.

        Errors are stored in the world, not raised.
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
        """File descriptors of the transport; none if it has failed."""
        if not self._failed:
            with self._contained("filenos()"):
                return self._transport.filenos()
        return []

    def on_readable(self, fd: int, t_ns: int) -> None:
        """Let the transport read the received data."""
        with self._contained("on_readable()"):
            self._transport.on_readable(fd, t_ns)

    def endpoint(self) -> Mapping[str, object]:
        """Endpoint of the transport; its exceptions are raised as `PackageError`."""
        with errors_as_package_error(self._kind, self._model.package, "endpoint()"):
            return self._transport.endpoint()

    def close(self) -> None:
        """Close the transport; its error is stored in the world."""
        with self._contained("close()"):
            self._transport.close()
