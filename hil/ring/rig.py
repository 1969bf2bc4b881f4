"""All devices of a bench as one thing: opened in order, drained once per cycle, always closed."""

from __future__ import annotations

from dataclasses import dataclass, fields

from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import DeviceError
from hil.vocabulary.interfaces import Actuators, Device, Sensor
from hil.vocabulary.signals import EncoderSample, ImuSample, Inputs, MocapSample, TrackerSample


@dataclass
class Rig:
    """The devices; one that the bench lacks is None."""

    clock: Clock
    servos: Actuators | None = None
    encoders: Sensor[EncoderSample] | None = None
    imu: Sensor[ImuSample] | None = None
    tracker: Sensor[TrackerSample] | None = None
    mocap: Sensor[MocapSample] | None = None

    def devices(self) -> tuple[Device, ...]:
        """Present devices, servos last so that nothing moves before the sensors answer."""
        names = [f.name for f in fields(self) if f.name not in ("clock", "servos")] + ["servos"]
        return tuple(d for d in (getattr(self, n) for n in names) if d is not None)

    def open(self) -> None:
        """Open every device; on failure close those already open and raise the first error."""
        opened: list[Device] = []
        try:
            for device in self.devices():
                device.open()
                opened.append(device)
        except BaseException:
            for device in reversed(opened):
                device.close()
            raise

    def close(self) -> None:
        """Close every device, servos first."""
        for device in reversed(self.devices()):
            device.close()

    def read(self, cycle: int) -> Inputs:
        """Drain every device once, the others while the servos answer; `t_ns` is when the reading began."""
        t_ns = self.clock.now_ns()
        if self.servos:
            self.servos.ask()
        encoders = self.encoders.read() if self.encoders else ()
        imu = self.imu.read() if self.imu else ()
        tracker = self.tracker.read() if self.tracker else ()
        mocap = self.mocap.read() if self.mocap else ()
        servos = self.servos.read() if self.servos else ()
        health = self.servos.read_health() if self.servos else ()
        return Inputs(cycle, t_ns, servos, health, encoders, imu, tracker, mocap)

    def actuators(self) -> Actuators:
        """The servos, or a `DeviceError` when the bench has none."""
        if self.servos is None:
            raise DeviceError(
                "servos", "the bench has no servos", remedy="add a [servos] section to the bench file"
            )
        return self.servos
