"""A gamepad moves the robot while its dead-man button is held, and ends the session when it is lost.

The gamepad is a virtual one of SDL itself.
"""

import pytest

from hil.core.errors import DeviceError
from hil.live.gamepad import BACK, Gamepad, sdl
from hil.live.held_keys import GONE, LONGEST_S

pytest.importorskip("sdl2", reason="PySDL2 is not installed", exc_type=ImportError)
S = 1_000_000_000


class Pad:
    """A virtual gamepad, and the keys that are read from it."""

    def __init__(self):
        self.api, self.t_ns = sdl(), 0
        self.index = self.api.SDL_JoystickAttachVirtual(self.api.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15, 0)
        assert self.index >= 0, self.api.SDL_GetError()
        self._stick = self.api.SDL_JoystickOpen(self.index)
        self.pad = Gamepad()
        self.keys = self.pad.on(lambda: self.t_ns)

    def button(self, name, down):
        number = getattr(self.api, f"SDL_CONTROLLER_BUTTON_{name}")
        assert self.api.SDL_JoystickSetVirtualButton(self._stick, number, down) == 0

    def axis(self, name, value):
        number = getattr(self.api, f"SDL_CONTROLLER_AXIS_{name}")
        assert self.api.SDL_JoystickSetVirtualAxis(self._stick, number, value) == 0

    def lose(self):
        assert self.api.SDL_JoystickDetachVirtual(self.index) == 0
        self.index = -1

    def close(self):
        self.pad.close()
        self.api.SDL_JoystickClose(self._stick)
        if self.index >= 0:
            self.lose()


@pytest.fixture
def pad():
    found = Pad()
    yield found
    found.close()


def test_stick_and_cross_count_only_while_the_dead_man_is_held(pad):
    pad.axis("LEFTY", -30000)
    assert pad.keys.held() == ""
    pad.button("LEFTSHOULDER", 1)
    assert pad.keys.held() == "w"
    pad.axis("LEFTY", 30000)
    assert pad.keys.held() == "s"
    pad.axis("LEFTY", 9000)
    assert pad.keys.held() == ""
    pad.axis("LEFTX", -20000)
    assert pad.keys.held() == "a"
    pad.axis("RIGHTX", 25000)
    assert pad.keys.held() == "e"
    pad.button("DPAD_RIGHT", 1)
    assert pad.keys.held() == "d"
    pad.button("LEFTSHOULDER", 0)
    assert pad.keys.held() == ""


def test_a_lost_gamepad_ends_the_keys_at_once(pad):
    pad.button("LEFTSHOULDER", 1)
    pad.button("DPAD_UP", 1)
    assert pad.keys.held() == "w"
    pad.lose()
    assert pad.keys.held() == ""
    assert pad.keys.ended == GONE


def test_a_stuck_stick_is_ignored_and_back_ends(pad):
    pad.button("LEFTSHOULDER", 1)
    pad.button("DPAD_UP", 1)
    assert pad.keys.held() == "w"
    pad.t_ns += int(LONGEST_S * S) + 1
    assert pad.keys.held() == ""
    assert pad.keys.stuck == 1
    pad.button("BACK", 1)
    assert pad.keys.held() == ""
    assert pad.keys.ended == BACK


def test_without_a_gamepad_nothing_begins():
    with pytest.raises(DeviceError, match="none is connected"):
        Gamepad()
