"""A key of a terminal moves the robot while it is held, and for no longer than the longest time."""

import os
import pty

import pytest

from hil.live.held_keys import LET_GO_S, LONGEST_S, HeldKeys, key_by_key

MS = 1_000_000


class Terminal:
    """A terminal with keys on it, read every 10 ms of a clock of its own."""

    def __init__(self):
        self.t_ns = 0
        self.keyboard, self.line = pty.openpty()
        self.keys = HeldKeys(self.line, lambda: self.t_ns)

    def read(self, ms, pressed=b"", every_ms=30):
        """What is held, 10 ms by 10 ms, while a key is pressed and repeated."""
        found = []
        for k in range(ms // 10):
            if pressed and k * 10 % every_ms == 0:
                os.write(self.keyboard, pressed)
            self.t_ns += 10 * MS
            found.append(self.keys.held())
        return found


@pytest.fixture
def terminal():
    found = Terminal()
    with key_by_key(found.line):
        found.keys.held()
        yield found
    for descriptor in (found.keyboard, found.line):
        os.close(descriptor)


def test_a_held_key_counts_and_one_let_go_ends_in_time(terminal):
    assert terminal.read(600, b"w") == ["w"] * 60
    after = terminal.read(400)
    assert after[-1] == ""
    assert after.count("w") * 0.01 <= LET_GO_S
    assert after == sorted(after, reverse=True)  # once let go, let go


def test_a_tap_moves_for_a_moment_and_another_key_takes_over_at_once(terminal):
    tap = terminal.read(20, b"w", every_ms=1000)
    assert tap == ["w", "w"]
    assert set(terminal.read(100, b"\x1b[B")) == {"s"}
    assert terminal.read(300)[-1] == ""


def test_a_stuck_key_is_ignored_until_it_is_let_go(terminal):
    held = terminal.read(int(LONGEST_S * 1000) + 2000, b"q")
    assert held[0] == "q"
    assert held.count("q") * 0.01 == pytest.approx(LONGEST_S, abs=0.05)
    assert set(held[-100:]) == {""}
    assert terminal.keys.stuck == 1
    terminal.read(300)
    assert set(terminal.read(100, b"q")) == {"q"}


def test_keys_typed_while_nobody_asked_move_nothing(terminal):
    os.write(terminal.keyboard, b"wwww")
    terminal.t_ns += 500 * MS
    assert terminal.keys.held() == ""
    assert set(terminal.read(200)) == {""}


def test_the_end_is_a_key_or_the_loss_of_the_terminal():
    first = Terminal()
    with key_by_key(first.line):
        first.read(50, b"w")
        assert first.read(10, b"wx") == [""]
        assert first.keys.ended == "key x"
        second = HeldKeys(first.line, lambda: first.t_ns)
        os.close(first.keyboard)
        assert second.held() == ""
        assert second.ended == "terminal closed"
    os.close(first.line)


def test_the_operator_is_told_once_when_keys_begin_to_count(terminal):
    keys, told = HeldKeys(terminal.line, lambda: terminal.t_ns), []
    keys.ready = told.append
    os.write(terminal.keyboard, b"w")
    assert keys.over() == ""
    assert keys.held() == "", "what was pressed before counts for nothing"
    terminal.t_ns += 10 * MS
    os.write(terminal.keyboard, b"s")
    assert keys.held() == "s"
    assert told == [True], "and is told that it did"


def test_nobody_is_told_of_early_keys_who_pressed_none(terminal):
    keys, told = HeldKeys(terminal.line, lambda: terminal.t_ns), []
    keys.ready = told.append
    assert (keys.over(), keys.held()) == ("", "")
    assert told == [False]


def test_the_end_is_asked_for_before_keys_count(terminal):
    keys = HeldKeys(terminal.line, lambda: terminal.t_ns)
    keys.ready = lambda _: None
    os.write(terminal.keyboard, b"wx")
    assert keys.over() == "key x"
