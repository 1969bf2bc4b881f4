"""Writes the source of the function that encodes cycle records, once for each layout.

A record has some 250 values. A function that asks each for its layout spends more on asking than on the
values. The one written here names them one after the other, as `dataclasses` writes `__init__`: neighbouring
numbers, those of inner classes too, are packed in one step.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from hil.recording.cycle_layout import CODES, DTYPES, SHAPES, Layout
from hil.recording.value_encoders import FEW, array_head

Fields = Sequence[tuple[str, Layout]]


def _code_of(layout: Layout) -> str:
    """Code of a number in `struct`; empty for anything else."""
    return CODES.get(layout, "") if isinstance(layout, str) else ""


class EncoderSource:
    """Source of functions `(value, parts)` that append the bytes of a value to a list.

    It names what is in `hil.recording.value_encoders.BY_NAME`, and the constants.

    Args:
        classes: fields with their layouts, by class.
        codes: bytes of an enumeration's members by their values, by enumeration.

    Attributes:
        constants: what the source names besides.
    """

    def __init__(self, classes: Mapping[str, Fields], codes: Mapping[str, Mapping[Any, bytes]]) -> None:
        self._classes = classes
        self._codes = {name: f"codes_{number}" for number, name in enumerate(codes)}
        self.constants: dict[str, Any] = {self._codes[name]: table for name, table in codes.items()}
        self._lines: list[str] = []
        self._tables: list[str] = []  # lines that follow all functions
        self._called: dict[str, Layout] = {}  # functions that are named and not yet written
        self._numbers: list[tuple[str, str]] = []  # code and expression of numbers not yet packed
        self._waiting: list[str] = []  # expressions of bytes not yet appended
        self._depth = 0
        self._made = 0

    def function(self, name: str, fields: Fields) -> None:
        """Add a function of this name that writes these fields of a value."""
        with self._block(f"def {name}(value, parts):"):
            for field, layout in fields:
                self._value(layout, f"value.{field}")
        while self._called:
            called, layout = self._called.popitem()
            with self._block(f"def {called}(value, parts):"):
                self._value(layout, "value")

    def text(self) -> str:
        """The source."""
        return "\n".join([*self._lines, *self._tables])

    def _name(self, what: str) -> str:
        self._made += 1
        return f"{what}_{self._made}"

    def _line(self, line: str) -> None:
        self._lines.append("    " * self._depth + line)

    def _local(self, expression: str) -> str:
        """Name of a variable that holds it."""
        if expression.isidentifier():
            return expression
        name = self._name("v")
        self._line(f"{name} = {expression}")
        return name

    @contextmanager
    def _block(self, head: str) -> Iterator[None]:
        """What is written inside is appended inside."""
        self._append()
        self._line(head)
        self._depth += 1
        yield
        self._append()
        self._line("pass")
        self._depth -= 1

    def _append(self) -> None:
        """Write the line that appends all that waits."""
        self._pack()
        if self._waiting:
            self._line(f"parts += ({', '.join(self._waiting)},)")
            self._waiting = []

    def _count(self, value: str) -> None:
        """Write how many items there are, together with numbers that wait."""
        number = self._local(f"len({value})")
        if self._numbers:
            self._numbers.append(("I", number))
        else:
            packed = self._packed(("I", number))
            self._waiting.append(f"counts[{number}] if {number} < {FEW} else {packed}")

    def _bytes(self, *expressions: str) -> None:
        self._pack()
        self._waiting += expressions

    def _packed(self, *more: tuple[str, str]) -> str:
        """Expression that packs the waiting numbers and some more."""
        numbers = (*self._numbers, *more)
        name = "pack_" + "".join(code.replace("?", "b") for code, _ in numbers)
        self.constants[name] = struct.Struct("<" + "".join(code for code, _ in numbers)).pack
        return f"{name}({', '.join(value for _, value in numbers)})"

    def _pack(self) -> None:
        if self._numbers:
            self._waiting.append(self._packed())
            self._numbers = []

    def _value(self, layout: Layout, value: str) -> None:
        """Write one value, given as an expression without side effects."""
        if code := _code_of(layout):
            self._numbers.append((code, value))
        elif isinstance(layout, str):
            plain: dict[str, Callable[[str], None]]
            plain = {"str": self._str, "array": self._array, "any": self._any}
            plain[layout](value)
        else:
            nested: dict[str, Callable[[Any, str], None]] = {
                "class": self._class,
                "enum": self._enum,
                "samples": self._samples,
                "tuple": self._tuple,
                "optional": self._optional,
                "mapping": self._mapping,
            }
            nested[layout[0]](layout[1], value)

    def _str(self, value: str) -> None:
        self._bytes(f"text({value})")

    def _array(self, value: str, shape: tuple[int, ...] = ()) -> None:
        """Write an array; one of a single row of a length that is known is told by fewer looks."""
        value, head = self._local(value), self._name("head")
        known, found = "", f"heads[{value}.shape]"
        if len(shape) == 1:
            known, found = f" and {value}.ndim == 1 and len({value}) == {shape[0]}", f"row_of_{shape[0]}"
            self.constants[found] = array_head(DTYPES[b"d"], shape)
        self._line(f"if type({value}) is ndarray and {value}.dtype is double{known}:")
        self._line(f"    {head}, {value} = {found}, {value}.tobytes()")
        self._line("else:")
        self._line(f"    {head}, {value} = array({value})")
        self._bytes(head, value)

    def _any(self, value: str) -> None:
        self._append()
        self._line(f"free({value}, parts)")

    def _class(self, name: str, value: str) -> None:
        value = self._local(value)
        for field, layout in self._classes[name]:
            if layout == "array":
                self._array(f"{value}.{field}", SHAPES.get(name, {}).get(field, ()))
            else:
                self._value(layout, f"{value}.{field}")

    def _enum(self, name: str, value: str) -> None:
        self._bytes(f"{self._codes[name]}[{value}._value_]")

    def _samples(self, classes: Mapping[str, str], value: str) -> None:
        """Tuples of samples by kind: a function for each kind's class, written after this one."""
        encoders = self._name("encoders")
        value, kind, samples = self._local(value), self._name("kind"), self._name("samples")
        self._count(value)
        with self._block(f"for {kind}, {samples} in {value}.items():"):
            self._bytes(f"text({kind})")
            self._append()
            self._line(f"{encoders}[{kind}]({samples}, parts)")
        names = {kind: self._name("encode") for kind in classes}
        self._called |= {names[kind]: ["tuple", ["class", name]] for kind, name in classes.items()}
        table = ", ".join(f"{kind!r}: {name}" for kind, name in names.items())
        self._tables.append(f"{encoders} = {{{table}}}")

    def _remembering(self, made_by: str, value: str) -> None:
        """Write a value by a function of its own, which remembers the value before."""
        encode = self._name("encode")
        self._tables.append(f"{encode} = {made_by}")
        self._bytes(f"{encode}({value})")

    def _tuple(self, layout: Layout, value: str) -> None:
        if not isinstance(layout, str) and layout[0] == "enum":
            self._remembering(f"members_of({self._codes[layout[1]]})", value)
            return
        value = self._local(value)
        code = _code_of(layout)
        if code in ("q", "?"):
            self._remembering(f"whole_row_of({code!r})", value)
            return
        if code:
            self._bytes(f"row({code!r}, len({value}))(len({value}), *{value})")
            return
        item = self._name("item")
        self._count(value)
        with self._block(f"for {item} in {value}:"):
            self._value(layout, item)

    def _optional(self, layout: Layout, value: str) -> None:
        value = self._local(value)
        if code := _code_of(layout):
            without, given = self._packed(("?", "False")), self._packed(("?", "True"), (code, value))
            self._waiting.append(f"{without} if {value} is None else {given}")
            self._numbers = []
            return
        with self._block(f"if {value} is None:"):
            self._bytes(r"b'\x00'")
        with self._block("else:"):
            self._bytes(r"b'\x01'")
            self._value(layout, value)

    def _mapping(self, layout: Layout, value: str) -> None:
        if code := _code_of(layout):
            self._remembering(f"pairs_of({code!r})", value)
            return
        value, key, item = self._local(value), self._name("key"), self._name("item")
        self._count(value)
        with self._block(f"for {key}, {item} in {value}.items():"):
            self._bytes(f"text({key})")
            self._value(layout, item)
