"""Pose tracking: control laws, the module layer, limits, and scripted joint commands."""

from hil.controller.tracking import TrackingController, make_controller, make_modules

__all__ = ["TrackingController", "make_controller", "make_modules"]
