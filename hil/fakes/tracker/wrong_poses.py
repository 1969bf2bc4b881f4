"""Errors that a `wrong` fault adds to the poses of any emulated camera."""

from hil.faults.fault import Fault

_WRONG_SCALE = 1.2
_DRIFTS = ("drift_x_m_s", "drift_y_m_s")


def seen_scale(fault: Fault | None) -> float:
    """Factor of a `wrong` fault on the measured motion; 1 if the fault concerns something else."""
    if fault is None or ("scale" not in fault.options and fault.options):
        return 1.0
    return fault.option("scale", _WRONG_SCALE)


def seen_drift_m(fault: Fault | None, dt_s: float) -> tuple[float, float]:
    """Additional motion that a `wrong` fault adds to a step, in the wall's axes."""
    if fault is None:
        return 0.0, 0.0
    x_m_s, y_m_s = (fault.option(name, 0.0) for name in _DRIFTS)
    return x_m_s * dt_s, y_m_s * dt_s
