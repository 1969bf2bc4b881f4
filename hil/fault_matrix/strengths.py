"""Strengths of each fault in the campaign: options from below notice to extreme, of both signs.

The first strength of a fault is tested at every moment, the others in motion. A fault that changes neither
path nor messages at any strength tests nothing and is in no cell of a single fault.
"""

from collections.abc import Mapping, Sequence

DEFAULT = ""
"""The fault with its default options."""
_SHARES = ("probability=0.2", "probability=0.02", "probability=0.9")
_OF_ANY: Mapping[str, tuple[str, ...]] = {
    "drop": _SHARES,
    "corrupt": _SHARES,
    "truncate": _SHARES,
    "duplicate": (),
    "intermittent": (DEFAULT, "period_s=0.02,duty=0.5", "period_s=0.1,duty=0.9"),
    "silent": (DEFAULT, "direction=out", "direction=both"),
    "pieces": (DEFAULT, "size=1,gap_s=0", "size=30,gap_s=0.003"),
    "slow": (DEFAULT, "factor=2", "factor=50"),
    "delayed": (DEFAULT, "delay_s=0.03", "delay_s=0.5"),
}
"""Strengths by kind of fault."""
_OF_SENSORS: Mapping[str, tuple[str, ...]] = dict.fromkeys(
    ("drop", "corrupt", "truncate"), ("probability=0.9", "probability=0.2", "probability=0.02")
)
"""They send so often that a few lost messages change nothing."""
_OF_SERVOS: Mapping[str, tuple[str, ...]] = {
    "duplicate": ("probability=1",),
    "slow": (DEFAULT, "answer_s=0.0005", "answer_s=0.02"),
    "wrong": (DEFAULT, "angle_rad=0.01", "angle_rad=-0.1", "angle_rad=1", "share=0.9", "share=0.5"),
    "jump": (DEFAULT, "angle_rad=0.02", "angle_rad=-0.5", "angle_rad=3"),
}
_LATE = ("delay_s=0.5", "delay_s=0.03", DEFAULT)
"""Measurements of a force count until they are a quarter of a second old."""
_OF_FORCE = (DEFAULT, "factor=0.5", "factor=0.9", "factor=1.1", "factor=2", "factor=4")
_OF_CAMERA = (DEFAULT, "scale=0.5", "scale=0.97", "scale=-1", "drift_y_m_s=-0.02", "confidence=1")
_OF_DEVICE: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "servos": _OF_SERVOS,
    "servo": _OF_SERVOS,
    "encoders": {
        **_OF_SENSORS,
        "wrong": (DEFAULT, "offset_rad=0.01", "offset_rad=-0.2", "offset_rad=2"),
        "jump": (DEFAULT, "angle_rad=0.01", "angle_rad=-0.2", "angle_rad=2"),
    },
    "encoder": {
        **_OF_SENSORS,
        "wrong": (DEFAULT, "offset_rad=0.01", "offset_rad=-0.2", "offset_rad=2"),
        "jump": (DEFAULT, "angle_rad=0.01", "angle_rad=-0.2", "angle_rad=2"),
    },
    "imu": {"wrong": (DEFAULT, "rate_rad_s=0.005", "rate_rad_s=-0.1", "rate_rad_s=3"), "jump": ()},
    "tracker": {
        **_OF_SENSORS,
        "wrong": _OF_CAMERA,
        "jump": (DEFAULT, "distance_m=0.003", "distance_m=-0.1", "distance_m=10"),
    },
    "mocap": {**_OF_SENSORS, "wrong": (DEFAULT, "offset_m=0.003", "offset_m=-0.1", "offset_m=100")},
    "adhesion": {
        **_OF_SENSORS,
        "delayed": _LATE,
        "wrong": (*_OF_FORCE, "factor=-1"),
        "jump": (DEFAULT, "speed_rpm=500", "speed_rpm=-5000", "speed_rpm=20000"),
        "adhesion_loss": (DEFAULT, "factor=0.9", "factor=0.6", "factor=0,over_s=2"),
    },
    "plant": {"adhesion_loss": (DEFAULT, "factor=0.9", "factor=0.6", "factor=0,over_s=2")},
    "thrust": {
        **dict.fromkeys(("slow", "delayed", "drop", "silent", "intermittent", "pieces", "stuck"), ()),
        "wrong": _OF_FORCE,
        "jump": (DEFAULT, "steps=-5", "steps=60", "steps=-90"),
    },
    "load_cells": {
        **_OF_SENSORS,
        "delayed": _LATE,
        "wrong": (*_OF_FORCE, "factor=-1", "drift_n_s=-3"),
        "jump": (DEFAULT, "force_n=1", "force_n=-10", "force_n=100"),
    },
}
"""Strengths by device and kind of fault, in place of those of any device."""


def strengths_of(device: str, fault: str, options: Sequence[str]) -> tuple[str, ...]:
    """Return the strengths at which a fault is tested, each as `OPTION=NUMBER,...`.

    Args:
        device: name of the device among faults.
        fault: kind of fault.
        options: options that the device has for it.
    """
    own = _OF_DEVICE.get(device.split(".", 1)[0], {})
    found = own.get(fault, _OF_ANY.get(fault, (DEFAULT,)))
    return tuple(
        text for text in found if {part.split("=")[0] for part in text.split(",") if part} <= {*options}
    )
