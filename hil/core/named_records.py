"""Names the numbers in the flat memory block that compiled kernels read and write.

A class derived from `Record` lists its fields with their types: `float` or `int`, an array with its shape
(`Four`, `Annotated[Ints, 2]`), or another class derived from `Record`. `dtype_of` makes the numpy type from
it; a kernel then writes `m.tally.nis = 1.0`, which compiled is as quick as an index. At run time the object
is a numpy scalar, a view into its block.
"""

from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array

FLOAT_BYTES = 8

Four = Annotated[Array, 4]
"""Array (4,): one value per wheel, order FL, BL, BR, FR."""
Eight = Annotated[Array, 8]
"""Array (8,): x and y of each wheel's vector in turn, or one value per joint."""

Ints = npt.NDArray[np.int64]
"""Array of whole numbers (n,)."""

Records = npt.NDArray[np.void]
"""Array of one kind of record."""


class Record:
    """Base of classes that name the numbers of a block."""


def dtype_of(kind: type[Record], **more: np.dtype[Any]) -> np.dtype[Any]:
    """Numpy type of a record class.

    Args:
        kind: the class.
        more: further fields, placed after those of the class.
    """
    own = {name: _field(hint) for name, hint in get_type_hints(kind, include_extras=True).items()}
    return _named([(name, *field) for name, field in {**own, **{n: (t,) for n, t in more.items()}}.items()])


def filled(dtype: np.dtype[Any], values: Mapping[str, Any]) -> Records:
    """Make a block (1,) of a type from the values of all fields: numbers, arrays, or mappings for records.

    Raises:
        KeyError: a field without a value, or a value without a field.
    """
    block = np.zeros(1, dtype)
    names = dtype.names or ()
    if set(names) != set(values):
        raise KeyError(f"{sorted(set(names) ^ set(values))} is not both a field and a value")
    for name in names:
        inner = values[name]
        block[name] = filled(dtype[name], inner) if isinstance(inner, Mapping) else inner
    return block


def floats(records: Records) -> Array:
    """View records without integer fields as an array (n, floats per record)."""
    return records.view(np.float64).reshape(len(records), records.itemsize // FLOAT_BYTES)


def place(dtype: np.dtype[Any], path: str) -> int:
    """Index of the first float of a field in the block; `path` is dotted, also into arrays (`pose.2`)."""
    offset = 0
    for name in path.split("."):
        if dtype.fields is None:
            return offset // FLOAT_BYTES + int(name)
        dtype, start = dtype.fields[name][:2]
        offset += start
    return offset // FLOAT_BYTES


def part_of(dtype: np.dtype[Any], name: str) -> slice:
    """Slice of the floats in the block that a field occupies."""
    begin = place(dtype, name)
    return slice(begin, begin + dtype[name].itemsize // FLOAT_BYTES)


def _field(hint: Any) -> tuple[Any, ...]:
    """Numpy type of a field, and its shape if it is an array."""
    if hint in (float, int):
        return (np.float64 if hint is float else np.int64,)
    if isinstance(hint, type) and issubclass(hint, Record):
        return (dtype_of(hint),)
    array, *shape = get_args(hint)
    return np.int64 if array == Ints else np.float64, tuple(shape)


def _named(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """Numpy type whose scalars have their fields as attributes; `np.record` is five times slower."""
    attributes = {name: property(itemgetter(name), _setter(name)) for name, *_ in fields}
    scalar = type("RecordView", (np.void,), attributes)
    return np.dtype((scalar, np.dtype(fields, align=True)))


def _setter(name: str) -> Callable[[Any, Any], None]:
    def put(record: Any, value: Any) -> None:
        record[name] = value

    return put
