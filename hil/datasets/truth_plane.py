"""Checks that ground truth stays in the plane x, y of its frame: its z axis must be normal to the surface."""

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array

_LEAST_M, _SHARE = 0.03, 0.1
_TURNED_RAD = 0.3
_RANGE = (1.0, 99.0)
"""Percentiles in place of extremes, so that single wrong rows do not count."""


def check_plane(where: str, position_m: Array, wxyz: Array, remedy: str) -> None:
    """Refuse poses that leave the plane by a tenth of their way in it and 30 mm, or turn out by 0.3 rad.

    Wheels stay on the surface, so the frame is tilted or another axis is up. Lengths in the plane would then
    be wrong, and headings as well.

    Args:
        where: the file, for messages.
        position_m: (n, 3) positions.
        wxyz: (n, 4) unit quaternions.
        remedy: remedy where another axis is up.

    Raises:
        DataError: says by how much.
    """
    if not np.isfinite(position_m).any(axis=0).all():
        return
    low, high = np.nanpercentile(position_m, _RANGE, axis=0)
    x_m, y_m, z_m = high - low
    known = wxyz[np.isfinite(wxyz).all(axis=1)]
    w, x, y, z = known.T
    w0, x0, y0, z0 = known[len(known) // 2] if len(known) else (1.0, 0.0, 0.0, 0.0)
    beside = np.hypot(x * w0 - w * x0 - y * z0 + z * y0, y * w0 - w * y0 - z * x0 + x * z0)
    out_of_plane = float(np.percentile(beside, _RANGE[1])) if len(known) else 0.0
    turned_rad = 2.0 * float(np.arcsin(min(out_of_plane, 1.0)))
    out = []
    if z_m > max(_LEAST_M, _SHARE * float(np.hypot(x_m, y_m))):
        out.append(f"z moves by {z_m:.2f} m, x by {x_m:.2f} m, y by {y_m:.2f} m")
    if turned_rad > _TURNED_RAD:
        out.append(f"its body turns about other axes than z, by {turned_rad:.1f} rad")
    if out:
        raise DataError(
            where,
            f"the ground truth leaves the plane x, y: {'; '.join(out)}",
            expected="a frame whose z axis is normal to the surface that the wheels roll on",
            remedy=f"level the frame of the capture system; {remedy}",
        )
