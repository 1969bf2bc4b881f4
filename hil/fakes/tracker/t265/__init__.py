"""The emulated T265 tracking camera."""
