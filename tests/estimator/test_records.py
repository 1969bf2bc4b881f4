"""Numbers by name: where a field stands, what is refused, and what the filter shows of them."""

from typing import Annotated

import numpy as np
import pytest

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array
from hil.core.named_records import Ints, Record, dtype_of, filled, floats, part_of, place
from hil.estimator.kernel_layout import MEMORY, ROW, parameters
from hil.estimator.sensors import SENSORS
from hil.robot.kinematics import WheelGeometry


class Inner(Record):
    a: float
    b: Annotated[Array, 2, 3]


class Outer(Record):
    first: float
    inner: Inner
    last: float


class Counted(Inner):
    number: int
    numbers: Annotated[Ints, 2]


VALUES = {"first": 1.0, "inner": {"a": 2.0, "b": [[3.0, 4.0, 5.0], [6.0, 7.0, 8.0]]}, "last": 9.0}


def test_fields_stand_one_after_the_other_and_places_are_counted_in_floats():
    block = filled(dtype_of(Outer), VALUES)
    assert floats(block).tolist() == [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]]
    assert block[0].inner.b[1, 2] == 8.0
    for path, value in (("first", 1.0), ("inner.a", 2.0), ("inner.b.4", 7.0), ("last", 9.0)):
        assert floats(block)[0, place(block.dtype, path)] == value
    assert part_of(block.dtype, "inner") == slice(1, 8)


def test_a_record_is_a_view_into_its_block():
    block = filled(dtype_of(Outer), VALUES)
    block[0].inner.a = -1.0
    block[0].inner.b[0, 0] = -2.0
    assert floats(block)[0, 1:3].tolist() == [-1.0, -2.0]


def test_whole_numbers_stand_behind_the_fields_of_the_class_that_is_extended():
    block = filled(dtype_of(Counted), {"a": 2.0, "b": 0.5, "number": 2**53 + 1, "numbers": [3, 4]})
    assert block.dtype.names == ("a", "b", "number", "numbers")
    assert [block[0].number, *block[0].numbers] == [2**53 + 1, 3, 4]


@pytest.mark.parametrize("values", [{"first": 1.0, "last": 2.0}, {**VALUES, "more": 1.0}])
def test_a_field_without_a_value_or_a_value_without_a_field_is_refused(values):
    with pytest.raises(KeyError, match=r"inner|more"):
        filled(dtype_of(Outer), values)


def test_sensors_have_parts_of_their_own_that_do_not_overlap():
    for dtype in (MEMORY, ROW, parameters(EstimatorConfig(), WheelGeometry.nominal(), "wall").dtype):
        taken = np.zeros(dtype.itemsize // 8)
        for sensor in SENSORS:
            taken[part_of(dtype, sensor.NAME)] += 1
        assert taken.max() == 1


def test_every_figure_of_a_sensor_has_a_name_and_a_place_of_its_own():
    names = [name for s in SENSORS for name in s.FIGURES]
    places = [place(MEMORY, f"{s.NAME}.{path}") for s in SENSORS for path in s.FIGURES.values()]
    assert len(set(names)) == len(names)
    assert len(set(places)) == len(places)
