"""Arguments of the filter kernels: parameters, sensor memory and event rows.

Each is a numpy record with its own fields and one part per sensor under the sensor's name.
"""

from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import FLOAT_BYTES, Ints, Record, Records, dtype_of, filled, floats, place
from hil.estimator.process_model import ProcessParameters, process_values
from hil.estimator.sensors import SENSORS
from hil.estimator.sensors.measured_noise import MeasuredNoise
from hil.estimator.state_vector import AUX, ROWS, STATES
from hil.robot.kinematics import WheelGeometry

_NO_GATE = 1e300

Rows = Annotated[Array, ROWS]
State = Annotated[Array, STATES]
RowsByState = Annotated[Array, ROWS, STATES]
StateByRows = Annotated[Array, STATES, ROWS]


class FilterParameters(Record):
    """Gates and limits of the update.

    Attributes:
        gate_row, gate_pose: largest normalised innovation squared of one row, and of a pose.
        limit: consecutive rejections after which a sensor is let in again.
        samples: length of the running mean of normalised innovations.
    """

    gate_row: float
    gate_pose: float
    limit: float
    samples: float


class Work(Record):
    """Scratch memory of the kernels; its content is valid during one event only.

    Attributes:
        z, var, aux: results of `Sensor.observe`.
        mean, cross, own: predicted rows, their covariance with the state, and their own covariance.
        h: result of `Sensor.jacobian`.
        nu, shown, nis: innovations, a copy from before the update, and normalised innovations squared.
        before: state before the update.
        rolling: velocity measured by the wheels, m/s.
        root, up, down, high, low, centre, offset, odd, even: scratch memory of `hil.estimator.sigma_points`.
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
    """Parameters and scratch memory of all kernels; plus one part per sensor."""

    filter: FilterParameters
    process: ProcessParameters
    work: Work


class Memory(Record):
    """Sensor memory, stored with the state so that a rewind restores it; plus one part per sensor.

    Attributes:
        accepted: number of rows that have changed the state.
        duplicates: number of samples refused because of a repeated stamp.
        guarded: number of variances repaired by `hil.estimator.kalman_update.zero_negative_variances`.
    """

    accepted: float
    duplicates: float
    guarded: float


class EventRow(Record):
    """One sample: one part per sensor; all parts are zero but that of the sample's own sensor."""


class Samples(NamedTuple):
    """Samples as arrays, one per place.

    Attributes:
        t_ns: (n,) stamps.
        numbers: (n,) sensor numbers.
        seqs: (n,) sequence numbers.
        data: (n, floats of a row) event rows.
    """

    t_ns: Ints
    numbers: Ints
    seqs: Ints
    data: Array


class Events(NamedTuple):
    """Ring of events; event k is at index (first + k) % capacity of every array.

    Attributes:
        marks: (4,) first index, number of events, then two counters that readers do not need.
        t_ns: (capacity,) stamps.
        numbers: (capacity,) sensor numbers.
        rows: (capacity,) samples.
    """

    marks: Ints
    t_ns: Ints
    numbers: Ints
    rows: Records


class States(NamedTuple):
    """Filter states after events, one per place; or one single state, without the first dimension.

    Attributes:
        x: (n, 20) states.
        p: (n, 20, 20) covariances of the states.
        m: (n,) sensor memories.
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
    """`Parameters` (1,) of the kernels, with standard deviations squared where a variance is needed.

    An array of one record, because numba accepts it from Python twenty times as fast as a single record.
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


_MEASURED = [
    place(MEMORY, f"{sensor.NAME}.{name}.{figure}")
    for sensor in SENSORS
    for name, kind in get_type_hints(sensor.Memory).items()
    if kind is MeasuredNoise
    for figure in ("samples", "ratio", "factor")
]
"""Places of what was measured of the sensors' noise."""


def next_memory(m: Records) -> Records:
    """Initial memory (1,) of a filter that begins anew after m (1,): it keeps the measured noise."""
    memory = first_memory()
    floats(memory)[0, _MEASURED] = floats(m)[0, _MEASURED]
    return memory


def first_memory() -> Records:
    """Initial memory (1,) of a filter that has processed no sample."""
    memory = np.zeros(1, MEMORY)
    for sensor in SENSORS:
        for path, value in sensor.START.items():
            floats(memory)[0, place(MEMORY, f"{sensor.NAME}.{path}")] = value
    return memory
