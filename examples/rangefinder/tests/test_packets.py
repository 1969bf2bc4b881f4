"""The bytes on the wire, as the vendor's manual prints them and as a cable spoils them."""

import pytest

from hil_rangefinder import protocol as p

READING = p.Reading(distance=187, strength=1811, temperature_c=35.0)


@pytest.mark.parametrize(
    ("command", "payload", "printed"),
    [
        (p.VERSION, b"", "5A 04 01 5F"),
        (p.RESET, b"", "5A 04 02 60"),
        (p.RATE, b"\x64\x00", "5A 06 03 64 00 C7"),
        (p.FORMAT, b"\x06", "5A 05 05 06 6A"),
        (p.SAVE, b"", "5A 04 11 6F"),
    ],
)
def test_commands_are_those_of_the_manual(command, payload, printed):
    assert p.Command(command, payload).packet() == bytes.fromhex(printed)


def test_a_distance_is_nine_bytes():
    packet = READING.packet()
    assert packet.hex(" ").upper() == "59 59 BB 00 13 07 18 09 A8"
    assert p.parser().feed(packet) == [READING]


def test_packets_are_found_in_pieces_of_any_length():
    stream = READING.packet() + p.Command(p.VERSION, b"\x04\x03\x01").packet() + READING.packet()
    for size in range(1, len(stream) + 1):
        packets, found = p.parser(), []
        for at in range(0, len(stream), size):
            found += packets.feed(stream[at : at + size])
        assert found == [READING, p.Command(p.VERSION, b"\x04\x03\x01"), READING]


def test_a_spoilt_packet_is_told_once_and_the_next_is_found():
    whole = READING.packet()
    for place in range(len(whole)):
        spoilt = whole[:place] + bytes((whole[place] ^ 0x10,)) + whole[place + 1 :]
        assert p.parser().feed(whole + spoilt + whole + whole)[:2] == [READING, None]
        assert p.parser().feed(whole + spoilt + whole + whole)[-1] == READING


def test_who_begins_to_listen_in_the_middle_has_lost_nothing():
    whole = READING.packet()
    for at in range(len(whole)):
        assert None not in p.parser().feed(whole[at:] + whole)
