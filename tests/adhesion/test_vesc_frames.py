"""The codec of the VESC's frames against vectors written out by hand, and against the shipped DBC."""

import json
import math
from pathlib import Path

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import UsageError
from hil.links import vesc

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "vesc_frames.json").read_text())
DATABASE = cantools.database.load_file(vesc.DBC)
IN_DBC = {
    "erpm": "Erpm",
    "current_a": "MotorCurrent",
    "duty": "Duty",
    "drawn_ah": "ChargeDrawn",
    "charged_ah": "ChargeReturned",
    "drawn_wh": "EnergyDrawn",
    "charged_wh": "EnergyReturned",
    "fet_c": "FetTemperature",
    "motor_c": "MotorTemperature",
    "input_a": "InputCurrent",
    "position_deg": "Position",
    "tachometer": "Tachometer",
    "input_v": "InputVoltage",
    "adc1_v": "Adc1",
    "adc2_v": "Adc2",
    "adc3_v": "Adc3",
    "pulse": "Pulse",
}


def described(frame_id):
    """The DBC's message of an identifier, whatever controller it is of."""
    return DATABASE.get_message_by_frame_id(frame_id & ~0xFF, force_extended_id=True)


def hex_id(text):
    return int(text, 16)


@pytest.mark.parametrize("vector", GOLDEN["orders"], ids=lambda v: f"{v['packet']}-{v['value']}")
def test_orders_byte_for_byte_in_both_directions(vector):
    order = vesc.Order(vector["controller_id"], vesc.Packet[vector["packet"]], vector["value"])
    frame = vesc.order_frame(order)
    assert (frame.id, frame.data) == (hex_id(vector["id"]), bytes.fromhex(vector["data"]))
    assert vesc.decode(*frame) == order


@pytest.mark.parametrize("vector", GOLDEN["pings"], ids=lambda v: v["id"])
def test_pings_byte_for_byte(vector):
    frame = vesc.ping_frame(vector["controller_id"], vector["asker_id"])
    assert (frame.id, frame.data) == (hex_id(vector["id"]), bytes.fromhex(vector["data"]))


@pytest.mark.parametrize("vector", GOLDEN["reports"], ids=lambda v: f"{v['is']}-{v['data']}")
def test_reports_are_understood(vector):
    message = vesc.decode(hex_id(vector["id"]), bytes.fromhex(vector["data"]))
    assert message == getattr(vesc, vector["is"])(**vector["fields"])


@pytest.mark.parametrize("vector", GOLDEN["orders"], ids=lambda v: f"{v['packet']}-{v['value']}")
def test_the_dbc_sends_the_same_orders(vector):
    message = described(hex_id(vector["id"]))
    assert message.is_extended_frame
    (signal,) = message.signals
    assert message.encode({signal.name: vector["value"]}).hex().upper() == vector["data"]


@pytest.mark.parametrize(
    "vector", [v for v in GOLDEN["reports"] if v["is"] != "Pong"], ids=lambda v: f"{v['is']}-{v['data']}"
)
def test_the_dbc_reads_the_same_reports(vector):
    message = described(hex_id(vector["id"]))
    said = message.decode(bytes.fromhex(vector["data"]))
    wanted = {IN_DBC[k]: value for k, value in vector["fields"].items() if k in IN_DBC}
    assert said == pytest.approx(wanted)


def test_the_dbc_describes_every_packet_of_the_codec():
    assert {m.frame_id >> 8 for m in DATABASE.messages} == set(vesc.Packet)


@given(st.integers(0, (1 << 29) - 1), st.binary(max_size=8))
def test_whatever_is_on_the_bus_is_a_message_or_nothing(frame_id, data):
    message = vesc.decode(frame_id, data)
    assert message is None or isinstance(message, vesc.Message.__args__)


@pytest.mark.parametrize(("frame_id", "data"), [("0907", "0000EA60012C01"), ("12FE", ""), ("2007", "00" * 8)])
def test_short_and_foreign_frames_say_nothing(frame_id, data):
    assert vesc.decode(hex_id(frame_id), bytes.fromhex(data)) is None


@pytest.mark.parametrize(
    ("packet", "value", "frame_id", "data"),
    [("SET_CURRENT", 51.0, 0x0107, "0000C73803E8"), ("SET_CURRENT_REL", 0.5, 0x0A07, "0000C35003E8")],
)
def test_a_current_may_have_an_off_delay(packet, value, frame_id, data):
    order = vesc.Order(7, vesc.Packet[packet], value, off_delay_s=1.0)
    assert vesc.decode(frame_id, bytes.fromhex(data)) == order
    assert vesc.order_frame(order) == (frame_id, bytes.fromhex(data))


def test_nothing_else_has_an_off_delay():
    with pytest.raises(UsageError, match="off delay"):
        vesc.order_frame(vesc.Order(7, vesc.Packet.SET_DUTY, 0.5, off_delay_s=1.0))
    with pytest.raises(UsageError, match="off delay"):
        vesc.order_frame(vesc.Order(7, vesc.Packet.SET_CURRENT, 5.0, off_delay_s=40.0))


@pytest.mark.parametrize("value", [math.nan, math.inf, 3e9])
def test_what_the_wire_cannot_carry_is_refused(value):
    with pytest.raises(UsageError, match="SET_DUTY"):
        vesc.order_frame(vesc.Order(1, vesc.Packet.SET_DUTY, value))


def test_only_orders_are_sent_as_orders_and_only_to_controllers():
    with pytest.raises(UsageError, match="PING"):
        vesc.order_frame(vesc.Order(1, vesc.Packet.PING, 0.0))
    with pytest.raises(UsageError, match="controller id 256"):
        vesc.order_frame(vesc.Order(256, vesc.Packet.SET_DUTY, 0.0))
