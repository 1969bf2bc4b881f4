"""The keys that every table of a device in the bench file has."""

from typing import Annotated, ClassVar, Literal

from hil.config.assumed_parameters import TURNED, Parameter, plus, times
from hil.config.field_types import Delay, Strict, UnitQuaternion, Within

Metres = Annotated[float, Within(-5.0, 5.0, "m in the body")]
Position = tuple[Metres, Metres, Metres]


class DeviceConfig(Strict):
    """Base of the devices' tables; a model adds `model: Literal["its name"] = "its name"` and its own keys.

    Attributes:
        model: name of the device's model, within its kind.
        backend: `real`, or `emulated` for a device that the bench emulates.
        name: name of the device among several of its kind on the bench.
    """

    PATHS: ClassVar[tuple[str, ...]] = ()
    """Keys that hold paths: a relative one starts at the bench file's folder."""
    CHOSEN_BY_EMULATOR: ClassVar[tuple[str, ...]] = ()
    """Keys for the address of an emulated device: free addresses are chosen if only this process uses it."""
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()
    """Keys that scale a result or a safety figure."""
    SHARES_PORT_WITH: ClassVar[tuple[str, ...]] = ()
    """Models that may share the serial port of this one: one only writes, the other only reads."""

    backend: Literal["real", "emulated"] = "real"
    name: str | None = None

    def waits_for_loop(self) -> bool:
        """Whether samples wait up to a cycle until the loop takes them, which adds to their age.

        Samples that are requested a cycle ahead (`prefetch`) do.
        """
        return bool(getattr(self, "prefetch", False))

    def timeouts_s(self) -> float:
        """Sum of its timeouts, s: the longest that its driver may take for a device that does not answer."""
        given = (value for name, value in self if name.endswith("timeout_s"))
        return sum(float(value) for value in given if isinstance(value, (int, float)))


class MountedConfig(DeviceConfig):
    """A device whose mount on the robot matters.

    Attributes:
        mount_position_m, mount_rotation_wxyz: its frame in the body.
    """

    mount_position_m: Position = (0.0, 0.0, 0.0)
    mount_rotation_wxyz: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)


class ImuConfig(MountedConfig):
    """An inertial unit of any model: the keys that alignment and estimator need."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("mount_rotation_wxyz", TURNED, ("mocap", "tracker")),
    )


class TrackerConfig(MountedConfig):
    """A tracking camera of any model: the keys that alignment and estimator need.

    Attributes:
        scale: distance that the camera reports over the true distance; the alignment divides by it.
        scale_sigma: standard uncertainty of `scale` where it was measured (`tracker_extrinsics`): the
            estimator's prior for the scale error that is left, unless `estimator.tracker.scale_sigma` is
            given, too.
        latency_s: smallest time from exposure to the host, which no host clock can see.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("mount_rotation_wxyz", TURNED, ("mocap", "imu")),
        Parameter("mount_position_m", (plus(0.1), plus(0.0, -0.1)), ("mocap", "servos")),
        Parameter("scale", (times(1.3), times(0.75), times(1.1)), ("mocap", "servos")),
    )

    latency_s: Delay = 0.020
    scale: Annotated[float, Within(0.7, 1.35, "a camera that is further off is broken")] = 1.0
    scale_sigma: (
        Annotated[float, Within(1e-6, 0.2, "a scale less known than that was not measured")] | None
    ) = None
