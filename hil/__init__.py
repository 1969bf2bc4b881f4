"""Hardware-in-the-loop bench for a wall-climbing robot with four steered and driven wheels (4WIS4WID)."""

__version__ = "0.1.0"
