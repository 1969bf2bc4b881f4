"""DBC files of other nodes: any layout is read as cantools reads it, or refused by name."""

import cantools
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import hil
from hil.config.encoders import SHIPPED_DBC, EncodersConfig
from hil.config.load_cells import CanCellsConfig
from hil.core.errors import DataError, DeviceError
from hil.core.signals import Status
from hil.drivers.encoders.as5045.frame_layout import load_layout
from hil.drivers.load_cells.hx711.can_driver import CanCells
from hil.links.can_bus import frame_key

NAMES = EncodersConfig().signals
SHIPPED = cantools.database.load_file(SHIPPED_DBC)
MULTIPLEXED = """VERSION ""
BU_: N
BO_ {frame_id} Angles: 8 N
 SG_ Side M : 0|1@1+ (1,0) [0|1] "" N
 SG_ AngleFL m0 : 1|18@1+ (1,0) [0|0] "" N
 SG_ AngleBL m0 : 19|18@1+ (1,0) [0|0] "" N
 SG_ AngleBR m1 : 1|18@1+ (1,0) [0|0] "" N
 SG_ AngleFR m1 : 19|18@1+ (1,0) [0|0] "" N
 SG_ Sequence : 37|7@1+ (1,0) [0|0] "" N
 SG_ NodeTime : 44|20@1+ (1e-05,0) [0|0] "s" N
"""
EXTENDED = 1 << 31
CELLS = """VERSION ""
BU_: N
BO_ 100 Cells: 8 N
 SG_ Kind M : 48|8@1+ (1,0) [0|0] "" N
 SG_ Cell1 : 0|24@1- (1,0) [0|0] "" N
 SG_ Cell2 : 24|24@1- (1,0) [0|0] "" N
"""


@st.composite
def dbc_files(draw):
    """A message with words, counter and time at random places, multiplexed or not."""
    multiplexed = draw(st.booleans())
    sizes = [(name, 18) for name in NAMES]
    sizes += [("Sequence", draw(st.integers(2, 16))), ("NodeTime", draw(st.integers(8, 24)))]
    sizes += [("Other", draw(st.integers(1, 12)))]
    sizes = draw(st.permutations(sizes))
    big, lines, at = draw(st.booleans()), [], 0
    values = {name: draw(st.integers(0, 2)) for name in NAMES}
    if multiplexed:
        lines.append(f' SG_ Which M : {7 if big else 0}|8@{0 if big else 1}+ (1,0) [0|0] "" N')
        at = 8
    for name, bits in sizes:
        at += draw(st.integers(0, 5))
        start = at // 8 * 8 + 7 - at % 8 if big else at
        under = f" m{values[name]}" if multiplexed and name in NAMES else ""
        sign = draw(st.sampled_from("+-")) if name not in NAMES else "+"
        lines.append(f' SG_ {name}{under} : {start}|{bits}@{0 if big else 1}{sign} (1,0) [0|0] "" N')
        at += bits
    frame_id = draw(
        st.one_of(st.integers(0, 0x7FF), st.integers(0, (1 << 29) - 1).map(lambda i: i | EXTENDED))
    )
    assume(at <= 8 * 64)
    return frame_id, f'VERSION ""\nBU_: N\nBO_ {frame_id} All: 64 N\n' + "\n".join(lines) + "\n"


@given(dbc_files(), st.data())
def test_any_layout_is_decoded_as_cantools_does(tmp_path_factory, file, data):
    _, text = file
    path = tmp_path_factory.getbasetemp() / "random.dbc"
    path.write_text(text)
    (layout,) = load_layout(EncodersConfig(dbc=str(path))).values()
    oracle = cantools.database.load_string(text, "dbc").messages[0]
    assert layout.key == frame_key(oracle.frame_id, oracle.is_extended_frame)
    frame = bytearray(data.draw(st.binary(min_size=64, max_size=64)))
    multiplexers = [s for s in oracle.signals if s.is_multiplexer]
    if multiplexers:
        frame[0] = data.draw(
            st.sampled_from(sorted({i for s in oracle.signals for i in s.multiplexer_ids or ()}))
        )
    said = oracle.decode(bytes(frame), scaling=False)
    sequence, time_raw, words = layout.decode(bytes(frame))
    assert {NAMES[wheel]: word for wheel, word in words} == {n: v for n, v in said.items() if n in NAMES}
    assert (sequence, time_raw) == (said["Sequence"], said["NodeTime"])


class OtherNode:
    """Sends what the shipped node samples by another DBC, one frame for each value of its multiplexer."""

    def __init__(self, channel, text):
        self._channel, self._sampled = channel, {}
        self._message = cantools.database.load_string(text, "dbc").messages[0]

    def __getattr__(self, name):
        return getattr(self._channel, name)

    def transmit(self, frame_id, data, t_ns, **options):
        if frame_id not in (416, 417):
            return
        self._sampled |= SHIPPED.decode_message(frame_id, data, scaling=False)
        if frame_id == 416:
            return
        for side in (0, 1):
            values = {**self._sampled, "Side": side, "Sequence": self._sampled["Sequence"] % 128}
            names = {n for n in values if any(s.name == n for s in self._message.signals)}
            shown = {
                n for n in names if self._message.get_signal_by_name(n).multiplexer_ids in (None, [side])
            }
            frame = self._message.encode({n: values[n] for n in shown}, scaling=False)
            extended = self._message.is_extended_frame
            self._channel.transmit(self._message.frame_id, frame, t_ns, extended=extended, **options)


@pytest.mark.parametrize("frame_id", [0x1A0, 0x1A0 | EXTENDED, 0x12345 | EXTENDED])
def test_a_multiplexed_node_is_read(encoder_bench, steering_plant, drain, tmp_path, frame_id):
    text = MULTIPLEXED.format(frame_id=frame_id)
    path = tmp_path / "multiplexed.dbc"
    path.write_text(text)
    angles = (0.1, 0.2, 0.3, 0.4)
    bench = encoder_bench(
        plant=steering_plant(angles), config={"dbc": str(path)}, wire=lambda channel: OtherNode(channel, text)
    )
    bench.driver.open()
    samples = drain(bench, 20)
    assert len(samples) >= 38
    assert {s for sample in samples[1:] for s in sample.status} == {Status.OK}, "the first is of its start"
    assert samples[-1].angle_rad == pytest.approx(angles, abs=0.02)


def test_a_node_with_identifiers_of_another_width_is_told_from_a_silent_one(encoder_bench, tmp_path):
    text = MULTIPLEXED.format(frame_id=0x1A0 | EXTENDED)
    path = tmp_path / "eleven.dbc"
    path.write_text(MULTIPLEXED.format(frame_id=0x1A0))
    bench = encoder_bench(config={"dbc": str(path)}, wire=lambda channel: OtherNode(channel, text))
    with pytest.raises(DeviceError, match=r"0x1A0 \(29 bits\) with 8 bytes.*0x1A0 with 8 bytes"):
        bench.driver.open()


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("AngleFR m1 : 19|18@1+ (1,0)", "AngleFR m1 : 19|18@1- (1,0)", "AngleFR .* is signed"),
        ("AngleFR m1 : 19|18@1+ (1,0)", "AngleFR m1 : 19|18@1+ (0.1,0)", "AngleFR .* factor 0.1"),
        ("AngleFR m1 : 19|18@1+ (1,0)", "AngleFR m1 : 19|18@1+ (1,5)", "AngleFR .* offset 5"),
        ("Sequence : 37", "Sequence m0 : 37", "Sequence .* is multiplexed"),
    ],
)
def test_what_the_driver_does_not_apply_is_refused_by_name(tmp_path, old, new, what):
    path = tmp_path / "other.dbc"
    path.write_text(MULTIPLEXED.format(frame_id=100).replace(old, new))
    with pytest.raises(DataError, match=what):
        load_layout(EncodersConfig(dbc=str(path)))


def test_a_signal_in_two_messages_and_an_address_beyond_eleven_bits_are_refused(tmp_path):
    path = tmp_path / "other.dbc"
    text = MULTIPLEXED.format(frame_id=0x7FE)
    path.write_text(text)
    with pytest.raises(DataError, match="moves message Angles to 0x801"):
        load_layout(EncodersConfig(dbc=str(path), node_id=3))
    path.write_text(text + text[text.index("BO_") :].replace("2046 Angles", "100 Twice"))
    with pytest.raises(DataError, match="2 messages have a signal AngleFL"):
        load_layout(EncodersConfig(dbc=str(path)))


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("Cell2 : 24|24@1- (1,0)", "Cell2 m1 : 24|24@1- (1,0)", "multiplexed"),
        ("Cell2 : 24|24@1- (1,0)", "Cell2 : 24|24@1- (0.5,0)", "Cell2 .* factor 0.5"),
        ("Cell2 : 24|24@1- (1,0)", "Cell2 : 24|24@1+ (1,0)", "Cell2 .* unsigned"),
        ("Cell2 : 24|24@1- (1,0)", "Cell2 : 24|16@1- (1,0)", "Cell2 .* 16 bits"),
    ],
)
def test_counts_of_load_cells_are_decoded_whole_or_refused(tmp_path, old, new, what):
    path = tmp_path / "cells.dbc"
    path.write_text(CELLS)
    config = CanCellsConfig(interface="virtual", channel="none", dbc=str(path))
    assert CanCells(config, None).frame_ids() == (100,)
    path.write_text(CELLS.replace(old, new))
    with pytest.raises(DataError, match=what):
        CanCells(config, None).frame_ids()


@pytest.mark.parametrize(
    ("device", "text", "signal"),
    [
        ("encoders", MULTIPLEXED.format(frame_id=100).replace("18@1+ (1,0)", "18@1- (1,0)"), "AngleFL"),
        ("load_cells", CELLS.replace("Cell2 : 24|24@1- (1,0)", "Cell2 : 24|24@1- (0.5,0)"), "Cell2"),
        ("load_cells", CELLS.replace("Cell2 : 24", "Cell2 m1 : 24"), "Cell2"),
        ("load_cells", CELLS.replace("Cell2", "Other"), "Cell2"),
        ("encoders", "not a dbc at all {", ""),
    ],
)
def test_a_bench_names_itself_and_the_key_of_a_dbc_that_it_cannot_use(tmp_path, device, text, signal):
    path = tmp_path / "other.dbc"
    path.write_text(text)
    bench = hil.open_bench("emulated", overrides={f"{device}.dbc": str(path)})
    with pytest.raises(DataError) as caught, bench:
        pass
    said = str(caught.value)
    assert said.startswith(f"emulated: {device}.dbc: {path}: ")
    assert signal in said
    assert caught.value.remedy
    with pytest.raises(DataError, match=rf"{device}\.dbc"):
        bench.devices.sensors[device].open()
