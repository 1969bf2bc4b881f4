"""What a VESC says of itself, put together from its frames, whole or spoilt."""

import pytest

from hil.drivers.motor_controllers.vesc_settings import PROCESS, SHORT, Answers

NO_BYTES = bytes((0, 0, 0, 0, 0, 0))  # sender, command, length 0, and the checksum of nothing, which is 0


@pytest.mark.parametrize("length", range(len(NO_BYTES) + 1))
def test_a_long_answer_of_no_bytes_says_nothing(length):
    answers = Answers()
    answers.take(PROCESS, NO_BYTES[:length])
    assert answers.firmware == ""
    assert answers.settings is None


def test_firmware_is_reported_in_one_frame():
    answers = Answers()
    answers.take(SHORT, bytes((7, 0, 0, 6, 5)))
    assert answers.firmware == "6.05"
    assert not answers.complete
