"""What the emulated sensor answers to packets of several commands."""

from hil.fakes.imu.microstrain.commands import Commands, Settings
from hil.links.mip import fields as f
from hil.links.mip.packets import Field, Packet, PacketParser

INFO = f.DeviceInfo(1007, "3DM-CV7-AHRS", "6286-9960", "6286.34567", "I042Y", "8g, 300dps")


def replies(*descriptors):
    asked = Packet(f.BASE, tuple(Field(descriptor) for descriptor in descriptors))
    return PacketParser(10**9).feed(Commands(INFO, 500, Settings()).answer(asked), 0)


def test_replies_come_in_one_packet_as_far_as_they_fit():
    together, alone = replies(f.DEVICE_INFO, f.BUILT_IN_TEST), replies(f.DEVICE_INFO)
    assert len(together) == 1
    assert together[0].fields[: len(alone[0].fields)] == alone[0].fields


def test_replies_that_do_not_fit_into_one_packet_come_in_several():
    """A client that asks for the device's name six times had ended the emulator."""
    several, alone = replies(*[f.DEVICE_INFO] * 6), replies(f.DEVICE_INFO)
    assert len(several) > 1
    assert sum((packet.fields for packet in several), ()) == alone[0].fields * 6


def test_it_lists_what_it_can_as_mscl_asks_before_anything_else():
    """MicroStrain's MSCL sets up no channel of a sensor that does not answer (01, 04) and (01, 07)."""
    (packet,) = replies(f.DESCRIPTORS, f.MORE_DESCRIPTORS)
    assert packet.fields[0::2] == (Field(f.ACK, b"\x04\x00"), Field(f.ACK, b"\x07\x00"))
    listed, more = packet.fields[1::2]
    assert (listed.descriptor, more) == (0x82, Field(0x86))
    known = list(zip(listed.data[::2], listed.data[1::2], strict=True))
    assert known == sorted(set(known))
    assert {(0x01, 0x01), (0x01, 0x04), (0x0C, 0x0F), (0x82, 0x03), (0x82, 0xD5)} <= set(known)
