"""NatNet packets: the emulator's against an independent builder and PyPI `natnet`, the driver's parser
against both, and nothing but `MalformedPacket` from anything else."""

import contextlib
import struct

import natnet_builder as build
import pytest
from hypothesis import given
from hypothesis import strategies as st
from natnet.data_descriptions import DataDescriptions
from natnet.data_frame import DataFrame
from natnet.packet_buffer import PacketBuffer
from natnet.server_info import ServerInfo
from natnet.version import Version

from hil.drivers.mocap.natnet.messages import frame_number, parse_frame
from hil.drivers.mocap.natnet.packets import MalformedPacket, Message, parse_server_info, request, split
from hil.drivers.mocap.natnet.session import parse_models
from hil.fakes.mocap.natnet import encoding as natnet_encoding
from hil.fakes.mocap.natnet.camera_view import SeenBody
from tests.selected import draws

MARKERS = tuple((0.1 * k, 0.2 * k, 0.3 * k) for k in range(4))
SEEN = (
    SeenBody("other", 2, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), MARKERS, 0.0005),
    SeenBody("robot", 1, (-1.5, 0.25, 4.0), (0.5, -0.5, 0.5, 0.5), MARKERS, 0.00025, tracked=False),
)
TIMES = natnet_encoding.FrameTimes(12.5, 1000, 1400, 2000)


def payload(packet):
    return split(packet)[1]


@pytest.mark.parametrize("version", natnet_encoding.VERSIONS)
def test_emulated_frames_have_the_published_layout(version):
    """Byte for byte: three marker sets, two bodies, eight labelled markers, nothing else."""
    flat = [v for m in MARKERS for v in m]
    sets = [build.text(n) + build.points(*flat) for n in ("other", "robot")]
    sets.append(build.text("all") + build.points(*flat, *flat))
    bodies = [build.body(2), build.body(1, (-1.5, 0.25, 4.0), (0.5, -0.5, 0.5, 0.5), 0.00025, 0)]
    labelled = [
        struct.pack("<i3ffhf", i << 16 | k + 1, *MARKERS[k], 0.014, 0x0A, error)
        for i, error in ((2, 0.0005), (1, 0.00025))
        for k in range(4)
    ]
    sections = [sets, [], bodies, [], labelled, [], []]
    if version >= (4, 1):
        sections.insert(4, [])
    data = struct.pack("<i", 77) + b"".join(build.counted(s, version) for s in sections)
    precision = (0, 0) if version >= (4, 1) else ()
    end = "<IId3Q2IHi" if precision else "<IId3QHi"
    data += struct.pack(end, 0, 0, 12.5, 1000, 1400, 2000, *precision, 0, 0)
    assert natnet_encoding.Frames().frame(77, SEEN, TIMES, version) == build.message(7, data)


@pytest.mark.parametrize("version", natnet_encoding.VERSIONS)
def test_a_frame_is_the_same_whatever_was_sent_before(version):
    moved = SEEN[1]._replace(position_m=(3.0, 2.0, 1.0), markers_m=MARKERS[::-1], tracked=True)
    frames = natnet_encoding.Frames()
    for k, bodies in enumerate((SEEN, (SEEN[0], moved), SEEN[::-1], SEEN, SEEN[:1], (SEEN[0], moved))):
        times = natnet_encoding.FrameTimes(*(k + t for t in TIMES))
        assert frames.frame(k, bodies, times, version) == natnet_encoding.Frames().frame(
            k, bodies, times, version
        )


@pytest.mark.parametrize("version", natnet_encoding.VERSIONS)
def test_emulated_definitions_and_description_have_the_published_layout(version):
    names = (("other", 2), ("robot", 1))
    labels = b"".join(build.text(f"Marker{k}") for k in range(1, 5))
    sets = [(0, build.text(n) + struct.pack("<i", 4) + labels) for n in ("other", "robot", "all")]
    bodies = []
    for name, identifier in names:
        data = build.text(name) + struct.pack("<ii3fi", identifier, -1, 0, 0, 0, 4) + bytes(48 + 16)
        bodies.append((1, data + (labels if version >= (4, 0) else b"")))
    assert natnet_encoding.models(names, version) == build.models(version, *sets, *bodies)
    info = natnet_encoding.server_info(version, 10_000_000, 1511, "239.255.42.99")
    assert len(info) == 4 + 256 + 8 + 15
    assert info[4 + 256 + 4 : 4 + 256 + 8] == bytes((*version, 0, 0))
    assert info[-15:] == struct.pack("<QHB", 10_000_000, 1511, 1) + bytes((239, 255, 42, 99))


@pytest.mark.parametrize("version", natnet_encoding.VERSIONS)
def test_a_public_client_reads_the_emulated_packets(version):
    public = Version(*version)
    frame = natnet_encoding.Frames().frame(77, SEEN, TIMES, version)
    seen = DataFrame.read_from_buffer(PacketBuffer(payload(frame)), public)
    assert seen.prefix.frame_number == 77
    assert [b.id_num for b in seen.rigid_bodies] == [2, 1]
    assert seen.rigid_bodies[1].pos == (-1.5, 0.25, 4.0)
    assert [b.tracking_valid for b in seen.rigid_bodies] == [True, False]
    assert len(seen.labeled_markers) == 8
    assert (seen.suffix.timestamp, seen.suffix.stamp_transmit) == (12.5, 2000)
    models = payload(natnet_encoding.models((("other", 2), ("robot", 1)), version))
    described = DataDescriptions.read_from_buffer(PacketBuffer(models), public)
    assert [(b.name, b.id_num) for b in described.rigid_bodies] == [("other", 2), ("robot", 1)]
    info = payload(natnet_encoding.server_info(version, 10_000_000, 1511, None))
    assert ServerInfo.read_from_buffer(PacketBuffer(info), public).application_name == "Motive"


@pytest.mark.parametrize("version", build.VERSIONS)
@pytest.mark.parametrize("full", [True, False])
def test_the_driver_finds_its_body_among_everything_else(version, full):
    bodies = [build.body(5), build.body(-6, (0.5, -1.0, 2.0), (0.5, 0.5, -0.5, 0.5), 0.002, 0)]
    packet = build.frame(version, 9, bodies, full=full, flags=2)
    found = parse_frame(payload(packet), version, -6)
    assert found.body is not None
    assert found.body.position_m == (0.5, -1.0, 2.0)
    assert found.body.rotation_xyzw == (0.5, 0.5, -0.5, 0.5)
    assert found.body.marker_error_m == pytest.approx(0.002)
    assert not found.body.tracked
    assert (found.number, found.timestamp_s, found.models_changed) == (9, 12.5, True)
    assert (found.exposure_ticks, found.received_ticks, found.sent_ticks) == (1000, 1400, 2000)
    assert parse_frame(payload(packet), version, 6).body is None
    assert frame_number(payload(packet)) == 9


@pytest.mark.parametrize("version", [v for v in build.VERSIONS if v < (4, 2)])
def test_driver_and_public_client_agree(version):
    packet = payload(build.frame(version, 3, [build.body(4, (1.25, 2.5, -3.5))]))
    public = DataFrame.read_from_buffer(PacketBuffer(packet), Version(*version))
    ours = parse_frame(packet, version, 4)
    assert ours.body.position_m == public.rigid_bodies[0].pos
    assert ours.body.tracked == public.rigid_bodies[0].tracking_valid
    assert ours.sent_ticks == public.suffix.stamp_transmit


@pytest.mark.parametrize("version", build.VERSIONS)
def test_definitions_of_every_kind_are_passed_over(version):
    wanted = [(1, build.body_model(version, "robot", 4)), (1, build.body_model(version, "bär", -2, 0))]
    packet = build.models(version, *build.other_models(version), *wanted)
    assert parse_models(payload(packet), version) == {4: "robot", -2: "bär"}


def test_an_unknown_kind_of_definition_is_passed_over_where_its_size_is_reported():
    wanted = (1, build.body_model((4, 1), "robot", 4))
    sized = build.models((4, 1), (6, b"whatever"), wanted)
    assert parse_models(payload(sized), (4, 1)) == {4: "robot"}
    with pytest.raises(MalformedPacket, match="unknown kind 6"):
        parse_models(payload(build.models((4, 0), (6, b"whatever"), wanted)), (4, 0))


def test_server_descriptions_old_and_new():
    new = parse_server_info(payload(build.server_info((4, 1), 2_000_000, 1600, "239.1.2.3")))
    assert new.version == (4, 1)
    assert (new.clock_hz, new.data_port, new.multicast) == (2_000_000, 1600, "239.1.2.3")
    assert (new.application, new.application_version) == ("Motive", "3.1.0.2")
    old = parse_server_info(payload(build.server_info((2, 9), short=True)))
    assert (old.version, old.clock_hz, old.multicast) == ((2, 9), 0, None)
    assert parse_server_info(payload(build.server_info())).multicast is None


def test_requests_are_those_of_the_public_clients():
    assert request(Message.CONNECT, "Ping") == bytes.fromhex("00000500") + b"Ping\0"
    assert request(Message.KEEPALIVE) == bytes.fromhex("0a00010000")
    assert request(Message.REQUEST_MODELS) == bytes.fromhex("0400010000")
    assert request(Message.REQUEST, "Bitstream,3.1") == bytes.fromhex("02000e00") + b"Bitstream,3.1\0"


@pytest.mark.parametrize("version", build.VERSIONS)
def test_a_packet_cut_anywhere_is_malformed(version):
    packet = payload(build.frame(version, 9, [build.body(5)]))
    for end in range(len(packet)):
        with contextlib.suppress(MalformedPacket):
            cut = parse_frame(packet[:end], version, 5)
            assert (cut.number, len(packet) - end <= 12) == (9, True)
    definitions = payload(build.models(version, *build.other_models(version)))
    for end in range(len(definitions)):
        with pytest.raises(MalformedPacket):
            parse_models(definitions[:end], version)
    description = payload(build.server_info())
    for end in range(264):
        with pytest.raises(MalformedPacket, match="too short"):
            parse_server_info(description[:end])
    for end in range(4):
        with pytest.raises(MalformedPacket):
            split(packet[:end])
        with pytest.raises(MalformedPacket):
            frame_number(packet[:end])
    with pytest.raises(MalformedPacket, match="announced"):
        split(build.server_info()[:-1])


@draws(300)
@given(data=st.binary(max_size=400), version=st.sampled_from(build.VERSIONS))
def test_random_bytes_are_malformed_or_parsed_never_anything_else(data, version):
    for parse in (
        lambda: parse_frame(data, version, 1),
        lambda: parse_models(data, version),
        lambda: parse_server_info(data),
        lambda: split(data),
        lambda: frame_number(data),
    ):
        with contextlib.suppress(MalformedPacket):
            parse()


@draws(300)
@given(data=st.data(), version=st.sampled_from(build.VERSIONS))
def test_a_damaged_packet_is_malformed_or_parsed_never_anything_else(data, version):
    packet = bytearray(payload(build.frame(version, 9, [build.body(5)])))
    for place in data.draw(st.lists(st.integers(0, len(packet) - 1), min_size=1, max_size=4)):
        packet[place] = data.draw(st.integers(0, 255))
    with contextlib.suppress(MalformedPacket):
        parse_frame(bytes(packet), version, 5)
    packet = bytearray(payload(build.models(version, *build.other_models(version))))
    for place in data.draw(st.lists(st.integers(0, len(packet) - 1), min_size=1, max_size=4)):
        packet[place] = data.draw(st.integers(0, 255))
    with contextlib.suppress(MalformedPacket):
        parse_models(bytes(packet), version)
