"""Programs that have a port open, and those at its other end."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

from hil.support.port_users import own_descriptors_of, programs_behind, programs_with


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


SERVES = "import os, pty; print(os.ttyname(pty.openpty()[1]), flush=True); input()"


def test_who_serves_a_pseudo_terminal_is_found_by_any_name_of_it(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SERVES]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        name = tmp_path / "servos"
        name.symlink_to(process.stdout.readline().strip())
        assert [one.pid for one in programs_behind(str(name))] == [process.pid]
        process.communicate("\n")
        assert programs_behind(str(name)) == []
    (tmp_path / "file").touch()
    assert programs_behind(str(tmp_path / "file")) == []
