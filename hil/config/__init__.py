"""Bench configuration: one strict model per device and concern, put together in `hil.config.bench`."""
