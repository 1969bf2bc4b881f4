"""Driver of the T265 tracking camera."""

from hil.drivers.tracker.emulated_pipeline import FeedPipeline
from hil.drivers.tracker.t265_driver import T265Tracker

__all__ = ["FeedPipeline", "T265Tracker"]
