"""A recording fed back through the pipeline: exact verification, and other estimators beside it."""
