"""The emulated T265 tracking camera."""

from hil.fakes.tracker.face import TrackerFace
from hil.fakes.tracker.options import IDEAL, TrackerTruthOptions
from hil.fakes.tracker.t265 import SUPPORTED_FAULTS, T265

__all__ = ["IDEAL", "SUPPORTED_FAULTS", "T265", "TrackerFace", "TrackerTruthOptions"]
