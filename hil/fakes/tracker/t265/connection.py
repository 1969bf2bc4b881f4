"""Connects the emulated T265: as the library's pipeline in this process, or by datagrams."""

from typing import Any

from hil.core.device import Connection
from hil.fakes.emulated_device import EmulatedDevice, EmulationRequest, Wired
from hil.fakes.tracker.t265.chip import T265
from hil.fakes.tracker.t265.pose_server import TrackerTransport


def emulated(model: Any, request: EmulationRequest) -> EmulatedDevice:
    """A camera whose poses come from a pipeline object, or from a server of poses.

    Args:
        model: model of the bench file.
        request: world and table of the bench file.
    """
    camera = T265.build(request)
    return Wired(lambda: Connection(parts={"pipeline": camera.pipeline()}), lambda: TrackerTransport(camera))
