"""Driver of the T265 tracking camera."""

from hil.drivers.tracker.feed import FeedPipeline
from hil.drivers.tracker.t265 import T265Tracker

__all__ = ["FeedPipeline", "T265Tracker"]
