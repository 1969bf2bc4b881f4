"""Programs that have a port open are counted while other threads open and close files."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from hil.support.port_users import own_descriptors_of, programs_with


def test_own_descriptors_are_counted_while_another_thread_opens_and_closes_files(tmp_path: Path) -> None:
    port = tmp_path / "port"
    port.touch()
    ended = threading.Event()

    def open_and_close() -> None:
        while not ended.is_set():
            for one in [os.open(os.devnull, os.O_RDONLY) for _ in range(20)]:
                os.close(one)

    beside = threading.Thread(target=open_and_close)
    beside.start()
    try:
        with port.open(), port.open():
            counts = {own_descriptors_of(str(port)) for _ in range(200)}
    finally:
        ended.set()
        beside.join()
    assert counts == {2}
    assert own_descriptors_of(str(port)) == 0


def test_an_entry_that_the_kernel_no_longer_has_hides_no_other(tmp_path: Path) -> None:
    entries = tmp_path / "812" / "fd"
    entries.mkdir(parents=True)
    (tmp_path / "812" / "comm").write_text("minicom\n")
    (entries / "0").touch()  # no link: reading it fails, as of a file that was closed meanwhile
    (entries / "1").symlink_to("/dev/ttyUSB0")
    assert [program.name for program in programs_with("/dev/ttyUSB0", tmp_path)] == ["minicom"]
