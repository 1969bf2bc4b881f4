"""The emulated T265: 200 Hz poses of visual odometry with errors, latency, confidence and faults.

It replaces camera and librealsense together: `pipeline()` returns an object with the interface of the
library's pipeline. Tracking starts with the stream.
"""

from __future__ import annotations

from collections import deque

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.geometry import Array
from hil.fakes.body_interface import BodyMotion
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.tracker.t265.faults import SUPPORTED_FAULTS, TrackerFaults
from hil.fakes.tracker.t265.librealsense_frames import MODEL, FrameCallback, PoseFrame, WorldPipeline
from hil.fakes.tracker.t265.wheel_odometer_input import WheelInput
from hil.fakes.tracker.true_parameters import TrackerTruthOptions
from hil.fakes.tracker.visual_odometry import VisualOdometry
from hil.fakes.world import NEVER_NS, Scheduled, World

__all__ = ["SUPPORTED_FAULTS", "T265"]

RATE_HZ = 200.0
_NS_PER_MS = 1e6
_FIRST_NUMBER = 1
_JUMPS, _PRESERVATION = "enable_pose_jumping", "enable_map_preservation"
SETTINGS = ("enable_mapping", "enable_relocalization", _JUMPS, _PRESERVATION)
"""Options of the camera's map, by librealsense's names; all on after power-up."""


class T265(Scheduled):
    """Emulated T265 tracking camera.

    Args:
        world: truth, seed and faults; the camera registers itself there.
        name: device name of its faults.
        options: true imperfections.
        mount_position_m, mount_rotation_wxyz: camera (robot axes) in the body, unless the options give the
            true mount.
        model: device name that it reports.
    """

    Options = TrackerTruthOptions
    alone = True
    announces = True

    @classmethod
    def build(cls, request: EmulationRequest) -> T265:
        """Make the camera, at the bench's mount, from its table of the bench file."""
        config = request.config
        return cls(
            request.world,
            name=request.kind,
            options=request.options(cls.Options),
            mount_position_m=config.mount_position_m,
            mount_rotation_wxyz=config.mount_rotation_wxyz,
        )

    def __init__(
        self,
        world: World,
        name: str = "tracker",
        options: TrackerTruthOptions | None = None,
        *,
        mount_position_m: tuple[float, float, float] = (0.1489, 0.0092, 0.0666),
        mount_rotation_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
        model: str = MODEL,
    ) -> None:
        self.name, self.model = name, model
        self._world = world
        self._options = options if options is not None else TrackerTruthOptions()
        self.firmware = self._options.firmware
        self._rng = world.rng(name)
        self.odometry = VisualOdometry(
            self._options,
            self._rng,
            mount_position_m=self._options.mount_position_m or mount_position_m,
            mount_rotation_wxyz=self._options.mount_rotation_wxyz or mount_rotation_wxyz,
        )
        self.serial = f"{int(self._rng.integers(0, 10**12)):012d}"
        self._epoch_ms = 1.6e12 + round(float(self._rng.uniform(0.0, 1e10)))
        self._fast_m2_s2 = self._options.fast_m_s**2
        self._stretch = 1.0 + 1e-6 * self._options.clock_ppm * float(self._rng.standard_normal())
        self._period_ns = NS_PER_S / RATE_HZ * self._stretch
        self._faults = TrackerFaults(world.faults, name, self._rng)
        self._callbacks: list[FrameCallback] = []
        self.settings = dict.fromkeys(SETTINGS, 1.0)
        self.wheels = WheelInput()
        self._travelling: deque[tuple[int, PoseFrame]] = deque()
        self._exposure_ns = NEVER_NS
        self._arrived_ns = 0
        world.add(self)

    def pipeline(self) -> WorldPipeline:
        """Return a replacement of `pyrealsense2.pipeline`; several may stream at once."""
        return WorldPipeline(self)

    def start_stream(self, callback: FrameCallback) -> None:
        """Start delivering poses to a callback; the first one starts the tracking.

        Raises:
            RuntimeError: no camera is plugged in; the message is that of the library.
        """
        if self._faults.find("unplug", self._world.now_ns) is not None:
            raise RuntimeError("No device connected")
        if not self._callbacks:
            self._restart(self._world.now_ns)
        self._callbacks.append(callback)

    def stop_stream(self, callback: FrameCallback) -> None:
        """Stop delivering poses to this callback; without callbacks the camera stops."""
        self._callbacks = [c for c in self._callbacks if c != callback]
        if not self._callbacks:
            self._rest()

    def streams_to(self, callback: FrameCallback) -> bool:
        """Return whether this callback still gets poses; an unplugged camera loses its streams."""
        return callback in self._callbacks

    @property
    def now_ns(self) -> int:
        """World time, ns."""
        return self._world.now_ns

    def next_due_ns(self) -> int:
        """Time of the next exposure or arrival."""
        travelling = self._travelling
        if travelling and travelling[0][0] < self._exposure_ns:
            return travelling[0][0]
        return self._exposure_ns

    def on_due(self, t_ns: int) -> None:
        """Deliver the poses that have arrived, then expose."""
        if not self._faults.plan.empty and self._unplugged(t_ns):
            return
        while self._travelling and self._travelling[0][0] <= t_ns:
            frame = self._travelling.popleft()[1]
            for callback in self._callbacks:
                callback(frame)
        if t_ns >= self._exposure_ns:
            self._expose(t_ns)

    def _unplugged(self, t_ns: int) -> bool:
        """Stop all streams while unplugged; they must be started again afterwards."""
        if self._faults.find("unplug", t_ns) is None:
            return False
        self._callbacks = []
        self._rest()
        return True

    def _rest(self) -> None:
        self._travelling.clear()
        self._exposure_ns = NEVER_NS
        self._world.changed(self)

    def _restart(self, t_ns: int) -> None:
        self.odometry.restart()
        self._number = _FIRST_NUMBER
        self._start_ns = self._exposed_ns = t_ns
        self._low_confidence_until_ns = 0
        self._settled = False
        self._exposure_ns = t_ns + nanoseconds(self._options.boot_s)
        self._world.changed(self)

    def _expose(self, t_ns: int) -> None:
        options = self._options
        faults = None if self._faults.plan.empty else self._faults
        if faults is not None and faults.restarted(t_ns):
            self._restart(t_ns)
            return
        period_factor = 1.0 if faults is None else faults.period_factor(t_ns)
        self._exposure_ns = t_ns + round(self._period_ns * period_factor)
        number, self._number = self._number, self._number + 1
        body = self._world.plant.body()
        dt_s, self._exposed_ns = (t_ns - self._exposed_ns) / NS_PER_S, t_ns
        if faults is not None:
            self.odometry.drift(*faults.drift_m(t_ns, dt_s))
        scale = 1.0 if faults is None else faults.scale(t_ns)
        by_wheels = self._by_wheels(body, t_ns) if self.wheels.taken else None
        pose = self.odometry.observe(body, dt_s, scale, by_wheels)
        if faults is not None or options.relocalisations_per_s > 0.0:
            self._relocalise(t_ns, dt_s)
        lost, jitter = self._rng.random(), self._rng.standard_exponential()
        if lost < options.drop_probability or (faults is not None and faults.off):
            return
        timestamp_ms = self._epoch_ms + t_ns / _NS_PER_MS / self._stretch
        frame = PoseFrame(number, timestamp_ms, pose, self._confidence(body, t_ns))
        late_ns = round((options.latency_s + options.jitter_s * jitter) * NS_PER_S)
        if faults is not None:
            late_ns += faults.lateness_ns(t_ns)
        if t_ns + late_ns > self._arrived_ns:
            self._arrived_ns = t_ns + late_ns
        for one in (frame,) if faults is None else faults.spoil(frame, t_ns):
            self._travelling.append((self._arrived_ns, one))

    def _by_wheels(self, body: BodyMotion, t_ns: int) -> tuple[Array, float] | None:
        """Velocity by the wheels in the camera's axes, and its weight; None without recent wheel data."""
        return self.wheels.velocity(t_ns, self.odometry.rate_rad_s(body.omega_rad_s))

    def _relocalise(self, t_ns: int, dt_s: float) -> None:
        rate = self._options.relocalisations_per_s
        if rate > 0.0 and self.settings[_JUMPS] and self._rng.random() < rate * dt_s:
            self.odometry.jump(self._options.relocalisation_m)
        distance_m = 0.0 if self._faults.plan.empty else self._faults.jump_m(t_ns)
        if distance_m:
            self.odometry.jump(distance_m)

    def _confidence(self, body: BodyMotion, t_ns: int) -> int:
        """Tracking confidence 0..3: low while the map is new and after fast motion."""
        vx, vy, omega = body.v_x_m_s, body.v_y_m_s, body.omega_rad_s
        options = self._options
        if abs(omega) > options.fast_rad_s or vx * vx + vy * vy > self._fast_m2_s2:
            self._low_confidence_until_ns = t_ns + nanoseconds(options.low_confidence_s)
        if t_ns < self._low_confidence_until_ns:
            return 1
        if self._settled:
            return 3
        age_s = (t_ns - self._start_ns) / NS_PER_S - options.boot_s
        for level, lasts_s in enumerate(options.settle_s):
            age_s -= lasts_s
            if age_s < 0.0:
                return level
        self._settled = True
        return 3
