"""What measures with which force the fan presses the robot on its surface."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from hil.core.device import DeviceKind, Figures, Plot, Topic
from hil.core.finding import Finding
from hil.core.signals import Inputs, LoadCellSample
from hil.devices.doctor_watch import Watched
from hil.devices.load_cells.doctor_check import look
from hil.devices.load_cells.hx711_model import Hx711Can, Hx711Line

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["CELLS", "KIND", "cell_state"]

CELLS = ("cell_1", "cell_2")


def cell_state(sample: LoadCellSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState`; effort holds the cells' forces in N, with their zeros."""
    return ros.joints(sample.stamp.t_ns, CELLS, effort=sample.force_n)


class LoadCells(DeviceKind):
    """Two cells between fan and chassis."""

    name, noun, sample = "load_cells", "load cells", LoadCellSample
    models, aliases, labels = (Hx711Can(), Hx711Line()), ("cells",), CELLS
    guards_hold = True
    max_age_s, max_gap_s, min_delivered = 0.02, 0.2, 0.9
    topics = (Topic("/adhesion/cells", "sensor_msgs/msg/JointState", cell_state),)
    plots = (Plot("Adhesion", "Load cells (N)", "adhesion/cells_n"),)
    silent_faults: ClassVar[Mapping[str, str]] = {
        "delayed": "a force of a moment ago is the same for a fan that turns steadily"
    }

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.adhesion_stale_s`."""
        return float(safety.adhesion_stale_s)

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Force of each cell."""
        if inputs.load_cells:
            values = inputs.load_cells[-1].force_n.tolist()
            yield "adhesion/cells_n", dict(zip(CELLS, values, strict=True))

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Conversions of each cell, noise, zero."""
        return look(watched)


KIND = LoadCells()
