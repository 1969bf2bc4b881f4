"""From a checked configuration to the rig: the real drivers, and where each finds its device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hil.config.bench import BenchConfig
from hil.drivers.encoders import As5045Encoders
from hil.drivers.imu import Bno055Imu
from hil.drivers.mocap import NatNetMocap
from hil.drivers.servos import XH430Servos
from hil.drivers.tracker import T265Tracker
from hil.ring.rig import Rig
from hil.vocabulary.clock import Clock


@dataclass
class Connections:
    """Where emulated devices are to be found; empty for a bench of hardware.

    Attributes:
        values: per device, keys of its configuration that say where it is (`port`, `channel`, ...).
        pipeline: stands in for the camera library's pipeline.
        datagrams: stands in for the network of the capture system.
    """

    values: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    pipeline: Any = None
    datagrams: Callable[..., Any] | None = None


def make_rig(config: BenchConfig, clock: Clock, connections: Connections) -> Rig:
    """Drivers of all configured devices, closed."""

    def at(name: str) -> Any:
        device = getattr(config, name)
        if device is None:
            return None
        return device.model_copy(update=dict(connections.values.get(name, {})))

    servos, encoders, imu, tracker, mocap = map(at, ("servos", "encoders", "imu", "tracker", "mocap"))
    return Rig(
        clock,
        servos=servos and XH430Servos(servos, clock),
        encoders=encoders and As5045Encoders(encoders, clock),
        imu=imu and Bno055Imu(imu, clock),
        tracker=tracker and T265Tracker(tracker, clock, pipeline=connections.pipeline),
        mocap=mocap and NatNetMocap(mocap, clock, datagrams=connections.datagrams),
    )
