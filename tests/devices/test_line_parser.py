"""Lines of a serial device, however its bytes arrive."""

from hypothesis import given
from hypothesis import strategies as st

from hil.devkit.driver import LineParser

LONGEST = 8


@given(st.lists(st.binary(max_size=12).map(lambda b: b.replace(b"\n", b" ").replace(b"\r", b" "))), st.data())
def test_lines_do_not_depend_on_how_the_bytes_arrive_and_too_long_ones_are_dropped(lines, data):
    stream = b"".join(line + data.draw(st.sampled_from([b"\n", b"\r\n"])) for line in lines)
    parser, found = LineParser(LONGEST), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += parser.feed(stream[:size])
        stream = stream[size:]
    assert found == [line for line in lines if len(line) <= LONGEST]
