"""The roll call on a bus with prescribed answers: who is late, what is said of it, how long one waits."""

from types import SimpleNamespace

import pytest

from hil.core.signals import Status
from hil.drivers.servos.dynamixel.bus import Exchange
from hil.drivers.servos.dynamixel.late_servos import LatencyProbe
from hil.drivers.servos.dynamixel.packets import Answer

IN_TIME_S, NEVER = 0.003, None
IDS = (11, 12, 13, 14, 15, 16, 17, 18)


class Line:
    """Servos that need so long to answer, s; one that is a list needs the next of it each time."""

    device = "servos"

    def __init__(self):
        self.now_ns, self.stray = 0, 0
        self.needs, self.asked = dict.fromkeys(range(8), 0.001), []

    def unasked(self):
        return self.stray

    def gather(self, duration_s, limit):
        self.now_ns += round(1e9 * duration_s)
        self.stray = 0
        return b""

    def exchange(self, group, timeout_s):
        needs = self.needs[group.joint]
        needs = needs.pop(0) if isinstance(needs, list) else needs
        heard = needs is not NEVER and needs <= timeout_s
        began_ns, self.now_ns = self.now_ns, self.now_ns + round(1e9 * (needs if heard else timeout_s))
        self.asked.append((group.joint, timeout_s))
        return Exchange(b"heard" if heard else b"", began_ns, self.now_ns, self.now_ns)


def request(joint):
    def answers(data):
        return {IDS[joint]: Answer(Status.OK) if data else Answer(Status.TIMEOUT)}

    return SimpleNamespace(joint=joint, answers=answers), IN_TIME_S


@pytest.fixture
def line():
    return Line()


@pytest.fixture
def roll(line):
    return LatencyProbe(line, IDS, SimpleNamespace(now_ns=lambda: line.now_ns), watchdog_s=0.08)


def said(caplog):
    return [record.getMessage() for record in caplog.records]


def test_who_is_late_each_time_is_late_and_who_is_once_in_time_is_not(line, roll, caplog):
    line.needs[2], line.needs[5] = 0.02, [0.02, 0.02, 0.001]
    assert roll.probe_all(request) == (2,)
    assert roll.late_s == {2: pytest.approx(0.02)}
    assert [joint for joint, _ in line.asked] == [0, 1, 2, 2, 2, 3, 4, 5, 5, 5, 6, 7]
    assert said(caplog) == [
        "servos: drive_BR (ID 13) answers after 20 ms, at most 3 ms are expected: it holds up the others"
    ]


def test_an_answer_at_the_very_edge_is_in_time_and_silence_is_not_lateness(line, roll, caplog):
    line.needs[0], line.needs[1] = IN_TIME_S + 0.0009, NEVER
    assert roll.probe_all(request) == ()
    assert said(caplog) == []
    assert [joint for joint, _ in line.asked].count(1) == 1


def test_what_changes_is_said_once(line, roll, caplog):
    line.needs[2], line.needs[3] = 0.02, 0.03
    roll.probe_all(request)
    roll.probe_all(request)
    line.needs[2], line.needs[3] = 0.001, NEVER
    roll.probe_all(request)
    roll.probe_all(request)
    assert [text.split(": ")[1] for text in said(caplog)] == [
        "drive_BR (ID 13) answers after 20 ms, at most 3 ms are expected",
        "drive_FR (ID 14) answers after 30 ms, at most 3 ms are expected",
        "drive_BR (ID 13) answers in time again",
        "drive_FR (ID 14) does not answer any more",
    ]
    assert roll.late_s == {}


def test_a_late_one_is_waited_for_only_where_there_is_time(line, roll, caplog):
    line.needs[2] = 0.02
    roll.probe_all(request)
    assert roll.ask(2, *request(2), patient=False).data == b""
    assert line.asked[-1] == (2, IN_TIME_S)
    assert 2 in roll.late_s, "nothing is learnt from a wait that was too short"
    assert roll.ask(2, *request(2), patient=True).data == b"heard"
    assert line.asked[-1] == (2, pytest.approx(0.03))
    roll.ask(3, *request(3), patient=True)
    assert line.asked[-1] == (3, IN_TIME_S)
    line.needs[2] = 0.001
    roll.ask(2, *request(2), patient=True)
    assert roll.late_s == {}
    assert said(caplog)[-1] == "servos: drive_BR (ID 13) answers in time again"


def test_it_is_due_when_bytes_come_unasked_and_not_soon_again(line, roll):
    assert not roll.is_due()
    line.stray = 12
    assert roll.is_due()
    roll.probe_all(request)
    line.stray = 12
    assert not roll.is_due()
    line.now_ns += 1_000_000_000
    assert roll.is_due()


def test_one_that_is_left_alone_is_asked_again_although_it_says_nothing(line, roll):
    line.needs[2] = 0.06
    roll.probe_all(request)
    assert roll.is_too_late(2)
    line.now_ns += 1_000_000_000
    assert roll.is_due()
    line.needs[2] = 0.05
    roll.probe_all(request)
    assert not roll.is_too_late(2)
    line.now_ns += 1_000_000_000
    assert not roll.is_due()


def test_dead_ones_make_it_stop_and_go_on_where_it_was(line, roll):
    line.needs = dict.fromkeys(range(8), NEVER)
    line.needs[7] = 0.02
    found = []
    for _ in range(4):
        began_ns = line.now_ns
        found.append(roll.probe_all(request))
        assert line.now_ns - began_ns < 700_000_000
    assert found == [(), (), (), (7,)]
    assert [joint for joint, _ in line.asked] == [0, 1, 2, 3, 4, 5, 6, 7, 7, 7, 0]
