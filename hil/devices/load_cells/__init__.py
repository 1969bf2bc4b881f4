"""What measures with which force the fan presses the robot on its surface."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from hil.devices.load_cells.hx711 import HX711_CAN, HX711_LINE
from hil.devices.load_cells.look import look
from hil.vocabulary.kinds import DeviceKind, Figures, Plot, Topic
from hil.vocabulary.signals import Inputs, LoadCellSample

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["CELLS", "KIND", "cell_state"]

CELLS = ("cell_1", "cell_2")


def cell_state(sample: LoadCellSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState`; effort holds the cells' forces in N, with their zeros."""
    return ros.joints(sample.stamp.t_ns, CELLS, effort=sample.force_n)


def _figures(inputs: Inputs) -> Iterator[tuple[str, Figures]]:
    if inputs.load_cells:
        values = inputs.load_cells[-1].force_n.tolist()
        yield "adhesion/cells_n", dict(zip(CELLS, values, strict=True))


KIND = DeviceKind(
    name="load_cells",
    noun="load cells",
    sample=LoadCellSample,
    models=(HX711_CAN, HX711_LINE),
    guards=True,
    aliases=("cells",),
    labels=CELLS,
    stale_s=lambda safety, own: safety.adhesion_stale_s,
    rate_hz=lambda own, loop_hz: float(own.rate_hz),
    age_s=0.02,
    gap_s=0.2,
    delivered=0.9,
    topics=(Topic("/adhesion/cells", "sensor_msgs/msg/JointState", cell_state),),
    figures=_figures,
    plots=(Plot("Adhesion", "Load cells (N)", "adhesion/cells_n"),),
    look=look,
    passes={"delayed": "a force of a moment ago is the same for a fan that turns steadily"},
)
