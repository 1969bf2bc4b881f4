"""A message of one layout that is packed in one step has the bytes of one that is written piece by piece."""

import struct

from hypothesis import given as drawn
from hypothesis import strategies as st

from hil.recording.cdr import TIME, CdrForm, CdrWriter, Doubles

NUMBERS = st.integers(0, 5)
SPARSE = st.tuples(NUMBERS, st.sets(NUMBERS)).map(
    lambda p: Doubles(p[0], tuple(sorted(p[1] & {*range(p[0])})))
)
PARTS = st.lists(
    st.just(TIME) | st.text(max_size=9) | st.integers(0, 2**32 - 1) | NUMBERS.map(Doubles) | SPARSE,
    max_size=9,
)


@drawn(PARTS, st.integers(-(2**62), 2**62), st.integers(0, 2**62), st.randoms())
def test_forms_pack_what_a_writer_writes(parts, t_ns, wall_ns, random):
    cdr, numbers = CdrWriter(wall_ns), []
    for part in parts:
        if part is TIME:
            cdr.time(t_ns)
        elif isinstance(part, str):
            cdr.text(part)
        elif isinstance(part, int):
            cdr.u32(part)
        else:
            given = range(part.number) if part.places is None else part.places
            values = {place: random.uniform(-1e3, 1e3) for place in given}
            numbers.append(list(values.values()))
            if part.number:
                cdr.doubles(*(struct.pack("<d", values.get(place, 0.0)) for place in range(part.number)))
    assert CdrForm(*parts).pack(t_ns, wall_ns, *numbers) == cdr.bytes()
