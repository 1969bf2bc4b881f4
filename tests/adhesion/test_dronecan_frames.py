"""The daemon's DroneCAN messages against what PyPI `dronecan` makes of the same values."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import UsageError
from hil.links.dronecan import messages as frames
from hil.links.dronecan.messages import StatusReader, command_frame, command_of, node_status_frame

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "dronecan_frames.json").read_text())
KINDS = {"raw_commands": (frames.RAW_COMMAND, "raw"), "rpm_commands": (frames.RPM_COMMAND, "rpm")}
COMMANDS = [(name, vector) for name in KINDS for vector in GOLDEN[name]]


def wire(vector):
    return [(int(frame_id, 16), bytes.fromhex(data)) for frame_id, data in vector["frames"]]


@pytest.mark.parametrize(("name", "vector"), COMMANDS)
def test_set_points_byte_for_byte_in_both_directions(name, vector):
    kind, field = KINDS[name]
    frame = command_frame(
        kind, vector["index"], vector[field], node_id=vector["node_id"], transfer_id=vector["transfer_id"]
    )
    assert [tuple(frame)] == wire(vector)
    assert command_of(*frame, vector["index"]) == (kind, vector[field])
    assert command_of(*frame, vector["index"] + 1) is None


@pytest.mark.parametrize("vector", GOLDEN["node_status"])
def test_node_status_byte_for_byte(vector):
    frame = node_status_frame(
        vector["uptime_s"], node_id=vector["node_id"], transfer_id=vector["transfer_id"]
    )
    assert [tuple(frame)] == wire(vector)


@pytest.mark.parametrize("vector", GOLDEN["statuses"])
def test_a_status_is_read_from_its_three_frames(vector):
    reader, given_ = StatusReader(), vector["fields"]
    *first, last = [reader.take(*frame) for frame in wire(vector)]
    assert first == [None, None]
    assert last.node_id == vector["node_id"]
    for name in ("error_count", "rpm", "power_pct", "index"):
        theirs = {"power_pct": "power_rating_pct", "index": "esc_index"}.get(name, name)
        assert getattr(last, name) == given_[theirs]
    assert last.voltage_v == pytest.approx(given_["voltage"], rel=1e-3)
    assert last.current_a == pytest.approx(given_["current"], rel=1e-3)
    kelvin = given_["temperature"]
    assert (
        math.isnan(last.temperature_k)
        if kelvin is None
        else last.temperature_k == pytest.approx(kelvin, 1e-3)
    )


def test_statuses_of_several_controllers_may_be_interleaved():
    reader = StatusReader()
    one = wire(GOLDEN["statuses"][0])
    other = [(frame_id & ~0x7F | 43, data) for frame_id, data in one]
    taken = [reader.take(*frame) for pair in zip(one, other, strict=True) for frame in pair]
    assert [s.node_id for s in taken if s is not None] == [42, 43]


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_status_with_a_frame_lost_is_none_and_the_next_is_read(lost):
    reader, whole = StatusReader(), wire(GOLDEN["statuses"][0])
    assert [reader.take(*f) for i, f in enumerate(whole) if i != lost] == [None, None]
    assert [reader.take(*f) for f in whole][-1] is not None


@given(st.integers(0, 2), st.integers(1, 13), st.integers(1, 255))
def test_a_status_with_a_bit_wrong_is_none(which, byte, flip):
    damaged = [(i, bytearray(d)) for i, d in wire(GOLDEN["statuses"][0])]
    data = damaged[which][1]
    data[byte % (len(data) - 1)] ^= flip
    reader = StatusReader()
    assert [reader.take(*f) for f in damaged] == [None] * 3


@given(st.lists(st.tuples(st.integers(0, (1 << 29) - 1), st.binary(max_size=8)), max_size=30))
def test_whatever_is_on_the_bus_is_survived(bus):
    reader = StatusReader()
    for frame_id, data in bus:
        reader.take(frame_id & 0x1F00007F | frames.STATUS << 8, data)
        reader.take(frame_id, data)
        command_of(frame_id, data, 0)


@given(
    st.sampled_from(sorted(KINDS.values())), st.integers(0, 2), st.integers(-8192, 8191), st.integers(0, 99)
)
def test_every_set_point_survives_the_wire(kind, index, value, transfer_id):
    frame = command_frame(kind[0], index, value, node_id=1, transfer_id=transfer_id)
    assert command_of(*frame, index) == (kind[0], value)


def test_the_same_bytes_as_the_library_makes_today():
    dronecan = pytest.importorskip("dronecan", reason="the extra dronecan is not installed")
    from dronecan.transport import Transfer

    esc = dronecan.uavcan.equipment.esc
    for kind, made in (
        (frames.RAW_COMMAND, esc.RawCommand(cmd=[0, 4660])),
        (frames.RPM_COMMAND, esc.RPMCommand(rpm=[0, 4660])),
    ):
        (theirs,) = Transfer(transfer_id=3, source_node_id=9, payload=made, transfer_priority=8).to_frames()
        ours = command_frame(kind, 1, 4660, node_id=9, transfer_id=3)
        assert (ours.id, ours.data) == (theirs.message_id, bytes(theirs.bytes))


@pytest.mark.parametrize(
    ("kind", "index", "value"), [(1030, 4, 0), (1030, 0, 8192), (1031, 3, 0), (1031, 0, 1 << 17)]
)
def test_what_fits_into_no_single_frame_is_refused(kind, index, value):
    with pytest.raises(UsageError, match="DroneCAN set-point"):
        command_frame(kind, index, value, node_id=1, transfer_id=0)
