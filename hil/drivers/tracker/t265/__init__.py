"""The Intel RealSense T265 tracking camera."""
