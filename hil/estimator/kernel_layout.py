"""What the kernels of the filter are given: parameters, sensor memory and event rows, put together by sensor.

Each is a numpy record: its own fields, and a part per sensor under the sensor's name.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import FLOAT_BYTES, Ints, Record, Records, dtype_of, filled, floats, place
from hil.estimator.process_model import ProcessParameters, process_values
from hil.estimator.sensors import SENSORS
from hil.estimator.state_vector import AUX, ROWS, STATES
from hil.robot.kinematics import WheelGeometry

_NO_GATE = 1e300

Rows = Annotated[Array, ROWS]
State = Annotated[Array, STATES]
RowsByState = Annotated[Array, ROWS, STATES]
StateByRows = Annotated[Array, STATES, ROWS]


class FilterParameters(Record):
    """How rows become an update.

    Attributes:
        gate_row, gate_pose: largest normalised innovation squared of one row, and of a pose.
        limit: rejections in a row after which a sensor is let in again.
        samples: length of the running mean of normalised innovations.
    """

    gate_row: float
    gate_pose: float
    limit: float
    samples: float


class Work(Record):
    """Room for what a kernel works out on the way to its result: nothing in it outlives one event.

    Attributes:
        z, var, aux: what `Sensor.observe` says of the sample.
        mean, cross, own: rows that the state predicts, their covariance with the state, and their own.
        h: `Sensor.jacobian`.
        nu, shown, nis: innovations, the same as they were before the update, and normalised.
        before: state before the update.
        rolling: velocity by the wheels, m/s.
        root, up, down, high, low, centre, offset, odd, even: of `hil.estimator.unscented`.
    """

    z: Rows
    var: Rows
    aux: Annotated[Array, AUX]
    mean: Rows
    cross: RowsByState
    own: Annotated[Array, ROWS, ROWS]
    h: RowsByState
    nu: Rows
    shown: Rows
    nis: Rows
    before: State
    rolling: Annotated[Array, 2]
    root: Annotated[Array, STATES, STATES]
    up: State
    down: State
    high: Rows
    low: Rows
    centre: Rows
    offset: Rows
    odd: StateByRows
    even: StateByRows


class Parameters(Record):
    """Parameters of all kernels, and room for them to work in; a further part per sensor."""

    filter: FilterParameters
    process: ProcessParameters
    work: Work


class Memory(Record):
    """What travels with the state, so that a rewind rewinds it, too; a further part per sensor.

    Attributes:
        accepted: how many rows have changed the state.
        duplicates: samples whose stamp was known.
        guarded: variances that rounding had made negative, see `hil.estimator.kalman_update.guard`.
    """

    accepted: float
    duplicates: float
    guarded: float


class EventRow(Record):
    """One sample: a part per sensor, of which all but that of the sample's own sensor are zero."""


class Samples(NamedTuple):
    """Samples, one in each place.

    Attributes:
        t_ns: (n,) stamps, and their
        numbers: (n,) of sensors,
        seqs: (n,) sequence numbers and
        data: (n, floats of a row) event rows.
    """

    t_ns: Ints
    numbers: Ints
    seqs: Ints
    data: Array


class Events(NamedTuple):
    """A ring of events; event k is in place (first + k) % capacity of every array.

    Attributes:
        marks: first place and number of events, then entries that readers do not need.
        t_ns: (capacity,) stamps.
        numbers: (capacity,) of sensors.
        rows: (capacity,) samples.
    """

    marks: Ints
    t_ns: Ints
    numbers: Ints
    rows: Records


class States(NamedTuple):
    """What the filter knows after events, one in each place; or at one time, without the first dimension.

    Attributes:
        x: (n, 20) states, and
        p: (n, 20, 20) their covariances, and
        m: (n,) memories.
    """

    x: Array
    p: Array
    m: Records


PARAMETERS = dtype_of(Parameters, **{s.NAME: dtype_of(s.Parameters) for s in SENSORS})
MEMORY = dtype_of(Memory, **{s.NAME: dtype_of(s.Memory) for s in SENSORS})
ROW = dtype_of(EventRow, **{s.NAME: dtype_of(s.Row) for s in SENSORS})

MEMORY_FLOATS = MEMORY.itemsize // FLOAT_BYTES
ROW_FLOATS = ROW.itemsize // FLOAT_BYTES


def parameters(config: EstimatorConfig, geometry: WheelGeometry, surface: str) -> Records:
    """`Parameters` (1,) of the kernels: standard deviations are squared where a variance is needed.

    An array, because numba takes it from Python twenty times as quickly as a single record.
    """
    gates = config.gates
    values: dict[str, Any] = {
        "filter": {
            "gate_row": gates.one_dof if gates.on else _NO_GATE,
            "gate_pose": gates.three_dof if gates.on else _NO_GATE,
            "limit": gates.reanchor_after,
            "samples": config.time.nis_samples,
        },
        "process": process_values(config, surface),
        "work": np.zeros(1, dtype_of(Work)),
        **{s.NAME: s.values(config, geometry, surface) for s in SENSORS},
    }
    return filled(PARAMETERS, values)


def first_memory() -> Records:
    """Memory (1,) of a filter that has seen nothing."""
    memory = np.zeros(1, MEMORY)
    for sensor in SENSORS:
        for path, value in sensor.START.items():
            floats(memory)[0, place(MEMORY, f"{sensor.NAME}.{path}")] = value
    return memory
