"""A flood of datagrams from anybody who reaches the port: bounded work in every read, counted and named."""

import logging

import pytest

WAITING = 1000
JUNK = {"packet heads": b"\xfd" * 1400, "empty": b"", "large": b"\xff" * 65_000}


def flood(link, data, count=WAITING):
    link.coming.extend([link.coming[0]._replace(data=data)] * count)


@pytest.mark.parametrize("kind", [*JUNK, "strangers"])
def test_one_read_looks_at_a_bounded_number_of_bytes_of_no_use(by_hand, odometry, common, kind, caplog):
    bench = by_hand()
    if kind == "strangers":
        beat = common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        bench.link.arrive(beat, source=(7, 1))
    else:
        bench.link.arrive(raw=JUNK[kind] or b"x")
    flood(bench.link, JUNK.get(kind, bench.link.coming[0].data))
    with caplog.at_level(logging.WARNING):
        for read in range(1, 4):
            before = len(bench.link.coming)
            assert bench.driver.read() == ()
            taken = before - len(bench.link.coming)
            assert 1 <= taken <= 256
            assert taken * len(JUNK.get(kind, b"")) <= 20_000 or taken == 1
            assert bench.driver.counts["floods"] == read
    assert caplog.text.count("another program floods") == 1


def test_poses_behind_a_flood_are_found_by_the_following_reads(by_hand, odometry):
    bench = by_hand()
    bench.link.arrive(raw=b"\xff" * 1400)
    flood(bench.link, b"\xff" * 1400, 30)
    bench.link.arrive(odometry(1.5, x=0.02))
    found = [len(bench.driver.read()) for _ in range(4)]
    assert found == [0, 0, 1, 0]


def test_a_sender_that_was_not_read_for_long_is_no_flood(by_hand, odometry):
    bench = by_hand()
    for k in range(200):
        bench.link.arrive(odometry(1.5 + 0.01 * k, x=1e-4 * k))
    assert len(bench.driver.read()) == 200
    assert bench.driver.counts["floods"] == 0
