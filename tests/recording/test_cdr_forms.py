"""A message of one layout that is packed in one step has the bytes of one that is written piece by piece."""

import struct

from hypothesis import given
from hypothesis import strategies as st

from hil.recording.cdr import TIME, CdrForm, CdrWriter, Doubles

PARTS = st.lists(
    st.just(TIME) | st.text(max_size=9) | st.integers(0, 2**32 - 1) | st.integers(0, 5).map(Doubles),
    max_size=9,
)


@given(PARTS, st.integers(-(2**62), 2**62), st.integers(0, 2**62), st.randoms())
def test_forms_pack_what_a_writer_writes(parts, t_ns, wall_ns, random):
    cdr, numbers = CdrWriter(wall_ns), []
    for part in parts:
        if part is TIME:
            cdr.time(t_ns)
        elif isinstance(part, str):
            cdr.text(part)
        elif isinstance(part, int):
            cdr.u32(part)
        elif part.number:
            numbers.append([random.uniform(-1e3, 1e3) for _ in range(part.number)])
            cdr.doubles(*(struct.pack("<d", value) for value in numbers[-1]))
    assert CdrForm(*parts).pack(t_ns, wall_ns, *numbers) == cdr.bytes()
