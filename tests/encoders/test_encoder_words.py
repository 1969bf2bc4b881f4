"""AS5045 words: golden vectors, parity law, and the chip against the decoder."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.signals import Status
from hil.drivers.encoders.as5045.word import decode_word
from hil.fakes.encoders.as5045.encoder import COF, FLAGS, LIN, MAG_DEC, MAG_INC, OCF, chip, with_parity, word

GOLDEN_FILE = Path(__file__).parents[1] / "golden" / "as5045_words.json"
GOLDEN = [(w["bits"], w["counts"], Status(w["status"])) for w in json.loads(GOLDEN_FILE.read_text())["words"]]


@pytest.mark.parametrize(("bits", "counts", "status"), GOLDEN)
def test_golden_words(bits, counts, status):
    found, why = decode_word(int(bits, 2))
    assert why is status
    assert math.isnan(found) if counts is None else found == pytest.approx(2 * math.pi * counts / 4096)


def test_yellow_mode_allows_a_magnet_out_of_the_recommended_range():
    word = with_parity(100 << 6 | OCF | MAG_INC | MAG_DEC)
    assert decode_word(word)[1] is Status.MAGNET
    assert decode_word(word, yellow_mode=True)[1] is Status.OK


@given(st.integers(0, (1 << 18) - 1), st.integers(0, 17))
def test_any_single_flipped_bit_breaks_parity(word, bit):
    good = with_parity(word)
    assert decode_word(good)[1] is not Status.PARITY
    assert decode_word(good ^ 1 << bit)[1] is Status.PARITY


@given(st.floats(-20, 20))
def test_chip_and_decoder_agree_to_half_a_count(angle):
    found, status = decode_word(word(chip(), 0, angle, 0.0, OCF))
    assert status is Status.OK
    assert abs(math.remainder(found - angle, 2 * math.pi)) <= math.pi / 4096 + 1e-9
    assert -math.pi <= found < math.pi


def test_an_eccentric_magnet_errs_once_and_twice_per_turn():
    eccentric = chip(once=(0.02, 0.4), twice=(0.005, -1.0))
    for k in range(64):
        theta = 2 * math.pi * k / 64
        found = decode_word(word(eccentric, 0, theta, 0.0, OCF))[0]
        expected = 0.02 * math.sin(theta + 0.4) + 0.005 * math.sin(2 * theta - 1.0)
        assert math.remainder(found - theta, 2 * math.pi) == pytest.approx(expected, abs=0.0008)


def test_after_a_cordic_overflow_the_last_good_angle_is_held():
    one = chip()
    before = word(one, 0, 1.0, 0.0, OCF) >> 6
    one[FLAGS] = COF
    assert word(one, 0, 2.0, 0.0, OCF) >> 6 == before
    one[FLAGS] = LIN
    assert word(one, 0, 2.0, 0.0, OCF) >> 6 != before
