"""The shipped DBC, cantools, the driver's bit positions and the node's firmware all say the same."""

import itertools

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.encoders import SHIPPED_DBC, EncodersConfig
from hil.core.errors import DataError
from hil.drivers.encoders.as5045.frame_layout import load_layout

DATABASE = cantools.database.load_file(SHIPPED_DBC)
LAYOUT = load_layout(EncodersConfig())
MOTOROLA = """VERSION ""
BU_: N
BO_ 100 All: 16 N
 SG_ AngleFL : 7|18@0+ (1,0) [0|0] "" N
 SG_ AngleBL : 21|18@0+ (1,0) [0|0] "" N
 SG_ AngleBR : 35|18@0+ (1,0) [0|0] "" N
 SG_ AngleFR : 49|18@0+ (1,0) [0|0] "" N
 SG_ Sequence : 87|8@0+ (1,0) [0|0] "" N
 SG_ NodeTime : 95|20@0+ (0.001,0) [0|0] "s" N
"""


@given(st.binary(min_size=8, max_size=8), st.sampled_from([416, 417]))
def test_fast_decoding_equals_cantools(data, frame_id):
    layout = LAYOUT[frame_id]
    message = DATABASE.get_message_by_frame_id(frame_id)
    decoded = message.decode(data, scaling=False)
    names = EncodersConfig().signals
    assert {names[wheel]: field.take(data) for wheel, field in layout.words} == {
        name: value for name, value in decoded.items() if name in names
    }
    assert layout.sequence.take(data) == decoded["Sequence"]
    assert layout.time.take(data) == decoded["NodeTime"]


def test_the_node_firmware_sends_what_the_dbc_says(encoder_bench, steering_plant):
    bench = encoder_bench(plant=steering_plant((0.1, 0.2, 0.3, 0.4)), jitter_s=0.0, clock_ppm=0.0)
    queue = bench.channel.listen()
    bench.clock.sleep_until_ns(100_000_000)
    frames = [message for _, message in queue]
    for name, frame_id in (("EncodersLeft", 416), ("EncodersRight", 417)):
        mine = [m for m in frames if m.arbitration_id == frame_id]
        decoded = [DATABASE.decode_message(m.arbitration_id, m.data) for m in mine]
        assert DATABASE.get_message_by_frame_id(frame_id).name == name
        assert [d["Sequence"] for d in decoded] == list(range(20))
        steps = [b["NodeTime"] - a["NodeTime"] for a, b in itertools.pairwise(decoded)]
        assert steps == pytest.approx([0.005] * 19, abs=2e-5)
        assert all(int(v).bit_count() % 2 == 0 for d in decoded[1:] for k, v in d.items() if "Angle" in k)


def test_the_node_address_moves_the_frames():
    assert set(load_layout(EncodersConfig(node_id=4))) == {420, 421}


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("not a dbc at all {", "not a usable DBC"),
        ('VERSION ""\n', "no signal"),
        (MOTOROLA.replace("AngleFR : 49|18", "AngleFR : 49|12"), "AngleFR .* 12 bits"),
        (MOTOROLA.replace("Sequence", "Counter"), "no signal Sequence"),
        (MOTOROLA.replace("AngleFR", "Other"), "no signal AngleFR"),
    ],
)
def test_a_dbc_that_does_not_fit_is_a_data_error_naming_it(tmp_path, text, what):
    path = tmp_path / "bad.dbc"
    path.write_text(text)
    with pytest.raises(DataError, match=what) as caught:
        load_layout(EncodersConfig(dbc=str(path)))
    assert str(path) in str(caught.value)


def test_a_missing_dbc_is_a_data_error():
    with pytest.raises(DataError, match="cannot be read"):
        load_layout(EncodersConfig(dbc="/no/such.dbc"))
