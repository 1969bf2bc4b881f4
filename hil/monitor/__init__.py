"""Live view of the loop in Rerun: what the operator sees, at no cost to the loop."""

from hil.monitor.scene import Scene
from hil.monitor.sink import RerunMonitor

__all__ = ["RerunMonitor", "Scene"]
