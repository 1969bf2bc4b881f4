"""Two recordings of one run on the clocks of two computers, and hardware clocks beside the wall clock.

A stand-in keeps the hardware clocks' time: an ordinary file is opened in the place of `/dev/ptp0`.
"""

import dataclasses
import time

import numpy as np
import pytest
from mcap_cases import driving_record
from recorded import HEADER, messages, recorded

from hil.core.clock import NS_PER_S, WallOffset
from hil.core.errors import DataError
from hil.recording.clock_offsets import PtpOffset, ptp_offsets, shift_between
from hil.recording.mcap_reader import read_cycles
from hil.recording.transform_tree import describe_clock

EPOCH_NS = 1_790_000_000 * NS_PER_S
TAI_NS = 37 * NS_PER_S
CYCLES = 50


def moved(record, by_ns):
    """The record as a computer stamps it whose bench clock is ahead by so much."""
    inputs = record.inputs
    servos = tuple(
        dataclasses.replace(
            s, stamp=dataclasses.replace(s.stamp, t_ns=s.stamp.t_ns + by_ns, host_ns=s.stamp.host_ns + by_ns)
        )
        for s in inputs.servos
    )
    state = dataclasses.replace(record.state, t_ns=record.state.t_ns + by_ns)
    inputs = dataclasses.replace(inputs, t_ns=inputs.t_ns + by_ns, servos=servos)
    return dataclasses.replace(
        record,
        start_ns=record.start_ns + by_ns,
        deadline_ns=record.deadline_ns + by_ns,
        inputs=inputs,
        state=state,
    )


def recording(path, zero_s, wall_error_ns=0, ptp_error_ns=None):
    """The run of `driving_record`, by a computer that was started `zero_s` before it.

    Args:
        wall_error_ns: by which its wall clock is ahead.
        ptp_error_ns: the same of its hardware clock; None for a computer without.
    """
    by_ns = round(zero_s * NS_PER_S)
    wall = WallOffset(EPOCH_NS - by_ns + wall_error_ns, 500, by_ns)
    ptp = []
    if ptp_error_ns is not None:
        ptp = [PtpOffset("ptp0", EPOCH_NS + TAI_NS - by_ns + ptp_error_ns, 900, by_ns)._asdict()]
    records = (moved(driving_record(k), by_ns) for k in range(CYCLES))
    return recorded(path, records, {**HEADER, "clock": describe_clock(wall, ptp)})


def servo_times(path, shift_ns=0):
    return np.array([r.inputs.servos[0].stamp.t_ns + shift_ns for r in read_cycles(path)])


def test_two_recordings_of_one_run_align_to_two_milliseconds_by_their_wall_clocks(tmp_path):
    first = recording(tmp_path / "a.mcap", zero_s=100.0)
    second = recording(tmp_path / "b.mcap", zero_s=98_765.4, wall_error_ns=800_000)
    shift = shift_between(first, second)
    assert shift.by == "wall clock"
    assert shift.uncertainty_ns == 1000
    apart_ns = servo_times(second, shift.shift_ns) - servo_times(first)
    assert np.abs(apart_ns).max() < 2_000_000
    stamps = []
    for path in (first, second):
        read = [message.header.stamp for topic, _, message in messages(path) if topic == "/joint_states"]
        stamps.append(np.array([s.sec * NS_PER_S + s.nanosec for s in read]))
    assert np.abs(stamps[1] - stamps[0]).max() < 2_000_000  # as other tools see them, too


def test_hardware_clocks_align_what_wall_clocks_do_not(tmp_path):
    first = recording(tmp_path / "a.mcap", zero_s=100.0, ptp_error_ns=0)
    second = recording(tmp_path / "b.mcap", 98_765.4, wall_error_ns=40_000_000, ptp_error_ns=2_000)
    shift = shift_between(first, second)
    assert (shift.by, shift.uncertainty_ns) == ("ptp0, ptp0", 1800)
    assert np.abs(servo_times(second, shift.shift_ns) - servo_times(first)).max() < 10_000
    alone = recording(tmp_path / "c.mcap", 98_765.4, wall_error_ns=40_000_000)
    by_wall = shift_between(first, alone)
    assert by_wall.by == "wall clock"
    assert np.abs(servo_times(alone, by_wall.shift_ns) - servo_times(first)).min() > 30_000_000


def test_a_hardware_clock_that_is_not_set_is_not_gone_by(tmp_path):
    first = recording(tmp_path / "a.mcap", zero_s=100.0, ptp_error_ns=0)
    second = recording(tmp_path / "b.mcap", zero_s=5.0, ptp_error_ns=-EPOCH_NS)
    assert shift_between(first, second).by == "wall clock"


def test_recordings_of_virtual_time_have_no_common_clock(tmp_path):
    header = {**HEADER, "clock": describe_clock(None)}
    path = recorded(tmp_path / "virtual.mcap", [driving_record(0)], header)
    with pytest.raises(DataError, match="nothing about the time of day"):
        shift_between(path, path)


def test_hardware_clocks_are_read_where_there_are_any(tmp_path):
    assert ptp_offsets(time.monotonic_ns, tmp_path) == ()
    for name in ("ptp0", "ptp1", "ptp_kvm"):
        (tmp_path / name).touch()
    base_ns = EPOCH_NS + TAI_NS
    found = ptp_offsets(time.monotonic_ns, tmp_path, read=lambda fd: base_ns + time.monotonic_ns())
    assert [one.device for one in found] == ["ptp0", "ptp1"]
    for one in found:
        assert abs(one.offset_ns - base_ns) <= one.uncertainty_ns < 5_000_000

    def refuses(fd):
        raise OSError("no clock behind it")

    assert ptp_offsets(time.monotonic_ns, tmp_path, read=refuses) == ()
    assert ptp_offsets(time.monotonic_ns, tmp_path) == ()  # an ordinary file is no clock
