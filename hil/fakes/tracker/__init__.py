"""The emulated T265 tracking camera."""

from hil.fakes.tracker.camera_truth import IDEAL, TrackerTruthOptions
from hil.fakes.tracker.pose_server import TrackerTransport
from hil.fakes.tracker.t265_camera import SUPPORTED_FAULTS, T265

__all__ = ["IDEAL", "SUPPORTED_FAULTS", "T265", "TrackerTransport", "TrackerTruthOptions"]
