"""The framing: packets of the vendor's manual, round trips, and everything that is no packet."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hil.links.mip.packets import Field, Packet, PacketParser, checksum, encode

PATIENCE_NS = 30_000_000
VENDOR = {
    "75650100DB05": Packet(0x01, ()),
    "756501020201E0C6": Packet(0x01, (Field(0x01),)),
    "7565010C080901010001C20004090301CE80": Packet(
        0x01, (Field(0x09, bytes.fromhex("01010001C200")), Field(0x09, bytes.fromhex("0301")))
    ),
    "75650C0E0E0F018003D5000A04000A05000A91CE": Packet(
        0x0C, (Field(0x0F, bytes.fromhex("018003D5000A04000A05000A")),)
    ),
    "7565010404F10600DA74": Packet(0x01, (Field(0xF1, bytes.fromhex("0600")),)),
}

payloads = st.lists(st.builds(Field, st.integers(0, 255), st.binary(max_size=40)), max_size=6)
packets = st.builds(lambda s, f: Packet(s, tuple(f)), st.integers(0, 255), payloads)


def parsed(data, chunk=1000):
    parser = PacketParser(PATIENCE_NS)
    found = []
    for at in range(0, len(data), chunk):
        found += parser.feed(data[at : at + chunk], at)
    return found


@pytest.mark.parametrize("text", VENDOR)
def test_packets_of_the_vendor(text):
    packet = VENDOR[text]
    assert encode(packet.descriptor_set, packet.fields).hex().upper() == text
    assert parsed(bytes.fromhex(text)) == [packet]


@given(st.lists(packets, max_size=5), st.integers(1, 50))
def test_what_is_encoded_is_parsed_however_it_is_cut(sent, chunk):
    wire = b"".join(encode(p.descriptor_set, p.fields) for p in sent)
    assert parsed(wire, chunk) == sent


@given(st.lists(st.binary(max_size=60), max_size=20), packets)
def test_no_bytes_whatever_upset_the_parser_for_long(noise, packet):
    parser = PacketParser(PATIENCE_NS)
    for k, chunk in enumerate(noise):
        parser.feed(chunk, k)
    wire = encode(packet.descriptor_set, packet.fields)
    found = []
    for k in range(1, 140):
        found += parser.feed(wire if k == 130 else b"", 2 * k * PATIENCE_NS)
    assert packet in found


def bits(wire):
    """The places of all bits of a packet behind its head, checksum included."""
    return [(place, bit) for place in range(4, len(wire)) for bit in range(8)]


@given(packets.flatmap(lambda p: st.tuples(st.just(p), st.sampled_from(bits(encode(*p))))))
@example((Packet(0, (Field(0, b"ue"), Field(0))), (8, 0)))  # the sync bytes, within a field
@example((Packet(0, (Field(0, b"ueue\0\0"), Field(0, b"ue"))), (4, 2)))
def test_one_flipped_bit_is_noticed(drawn):
    packet, (place, bit) = drawn
    wire = bytearray(encode(*packet))
    wire[place] ^= 1 << bit
    parser = PacketParser(PATIENCE_NS)
    assert parser.feed(bytes(wire), 0) == []
    assert parser.rejected == 1


def test_packets_among_other_bytes_are_found():
    ping = bytes.fromhex("756501020201E0C6")
    assert parsed(b"$GPGGA,uuu" + ping + b"u" + ping + b"ue") == [Packet(0x01, (Field(0x01),))] * 2


def test_a_spoilt_length_holds_the_next_packets_back_no_longer_than_the_patience():
    ping = bytes.fromhex("756501020201E0C6")
    parser = PacketParser(PATIENCE_NS)
    assert parser.feed(b"\x75\x65\x01\xff" + ping, 0) == []
    assert parser.feed(ping, PATIENCE_NS) == []
    assert parser.feed(b"", 2 * PATIENCE_NS) == [Packet(0x01, (Field(0x01),))] * 2
    assert parser.rejected == 1


def test_fields_that_do_not_fill_the_packet_make_it_none():
    frame = b"\x75\x65\x01\x03\x02\x01\x00"
    parser = PacketParser(PATIENCE_NS)
    assert parser.feed(frame + checksum(frame), 0) == []
    assert parser.rejected == 1


def test_too_much_for_one_packet_is_refused():
    with pytest.raises(ValueError, match="do not fit"):
        encode(0x82, [Field(1, bytes(200)), Field(2, bytes(60))])
