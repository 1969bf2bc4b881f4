"""A recording fed back through the brain: exact verification, and other estimators beside it."""
