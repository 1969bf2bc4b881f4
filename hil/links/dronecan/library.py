"""Access to the optional package PyPI `dronecan`: its import, and transfers to and from frames."""

from typing import Any

from hil.core.errors import ConfigError
from hil.support.extras import how_to_install, is_installed

Wire = tuple[int, bytes]
_MOST_TRANSFERS = 64


def library() -> Any:
    """Import the package; raises `ConfigError` where it is missing."""
    if not is_installed("dronecan"):
        raise ConfigError(
            'adhesion.model = "dronecan" needs PyPI dronecan', remedy=how_to_install("dronecan")
        )
    import dronecan

    return dronecan


def frames_of(payload: Any, *, source: int, transfer_id: int, priority: int, **service: Any) -> list[Wire]:
    """Identifier and data of each frame of a message, or of a service call with `dest_node_id`."""
    from dronecan.transport import Transfer

    transfer = Transfer(
        transfer_id=transfer_id, source_node_id=source, payload=payload, transfer_priority=priority, **service
    )
    return [(frame.message_id, bytes(frame.bytes)) for frame in transfer.to_frames()]


class Receiver:
    """Reassembles frames into transfers; drops frames that do not fit together."""

    def __init__(self) -> None:
        from dronecan.transport import TransferManager

        self._manager = TransferManager()

    def take(self, frame_id: int, data: bytes) -> Any | None:
        """Take a frame; returns the transfer that it completes, else None."""
        from dronecan.transport import Frame, Transfer

        if not data:
            return None
        if len(self._manager.active_transfers) > _MOST_TRANSFERS:
            self.__init__()  # type: ignore[misc]  # a node begins transfers and never ends them
        whole = self._manager.receive_frame(Frame(frame_id, data))
        if not whole:
            return None
        transfer = Transfer()
        try:
            transfer.from_frames(whole)
        except Exception:  # the library raises whatever a damaged payload leads to
            return None
        return transfer
