"""A gamepad as the source of the held key, read by SDL 2: stick or cross, while the left shoulder is held.

The library is PySDL2 with SDL's own binary (pysdl2-dll); it knows the layout of some hundreds of gamepads.
"""

import warnings
from collections.abc import Callable
from typing import Any

from hil.core.errors import DeviceError, UsageError
from hil.live.held_keys import GONE, Keys
from hil.support.extras import how_to_install

BACK = "button Back"
_CROSS = {"UP": "w", "DOWN": "s", "LEFT": "a", "RIGHT": "d"}
_STICKS = {"LEFTY": "ws", "LEFTX": "ad", "RIGHTX": "qe"}
_HALF = 1 << 14
"""Deflection of a stick from which it counts, of 32 767."""


def sdl() -> Any:
    """The module `sdl2`, ready for gamepads.

    Raises:
        UsageError: it is not installed.
        DeviceError: SDL cannot read gamepads here.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # it says which binary it uses
            import sdl2
    except ImportError as error:
        raise UsageError(
            f"a gamepad needs PySDL2, which cannot be imported ({error})", remedy=how_to_install("gamepad")
        ) from None
    sdl2.SDL_SetHint(sdl2.SDL_HINT_NO_SIGNAL_HANDLERS, b"1")
    sdl2.SDL_SetHint(sdl2.SDL_HINT_JOYSTICK_ALLOW_BACKGROUND_EVENTS, b"1")
    if sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER):
        raise DeviceError("gamepad", f"SDL cannot read gamepads: {sdl2.SDL_GetError().decode()}")
    return sdl2


class Gamepad:
    """The first gamepad that is connected.

    Attributes:
        name: name that SDL knows it by.

    Raises:
        UsageError: PySDL2 is not installed.
        DeviceError: no gamepad is connected, or it cannot be opened.
    """

    def __init__(self) -> None:
        self._sdl = sdl()
        found = [k for k in range(self._sdl.SDL_NumJoysticks()) if self._sdl.SDL_IsGameController(k)]
        self._pad = self._sdl.SDL_GameControllerOpen(found[0]) if found else None
        if not self._pad:
            raise DeviceError(
                "gamepad",
                f"cannot be opened: {self._sdl.SDL_GetError().decode()}" if found else "none is connected",
                remedy="connect one; your user must be able to read /dev/input/event* (often: be a member of "
                "the group input)",
            )
        self.name = str(self._sdl.SDL_GameControllerName(self._pad).decode("utf-8", "replace"))

    def on(self, now_ns: Callable[[], int]) -> Keys:
        """The keys of this gamepad, on the bench's time."""
        return GamepadKeys(self, now_ns)

    def attached(self) -> bool:
        """Whether it is still there; reads its state."""
        self._sdl.SDL_GameControllerUpdate()
        return bool(self._sdl.SDL_GameControllerGetAttached(self._pad))

    def button(self, name: str) -> bool:
        """Whether a button, as SDL names it, is pressed."""
        number = getattr(self._sdl, f"SDL_CONTROLLER_BUTTON_{name}")
        return bool(self._sdl.SDL_GameControllerGetButton(self._pad, number))

    def axis(self, name: str) -> int:
        """Deflection of an axis, as SDL names it, -32 768 to 32 767."""
        number = getattr(self._sdl, f"SDL_CONTROLLER_AXIS_{name}")
        return int(self._sdl.SDL_GameControllerGetAxis(self._pad, number))

    def close(self) -> None:
        """Close the gamepad."""
        self._sdl.SDL_GameControllerClose(self._pad)


class GamepadKeys(Keys):
    """The key of a gamepad: of its cross, or of the stick that is moved most.

    Args:
        pad: gamepad to read.
        now_ns: time of the bench.
    """

    def __init__(self, pad: Gamepad, now_ns: Callable[[], int]) -> None:
        super().__init__(now_ns)
        self._pad = pad

    def pressed(self, now_ns: int) -> str:
        """The key while the left shoulder is held; a gamepad that is gone ends the keys."""
        pad = self._pad
        if self.ended:
            return ""
        if not pad.attached():
            self.ended = GONE
        elif pad.button("BACK"):
            self.ended = BACK
        if self.ended or not pad.button("LEFTSHOULDER"):
            return ""
        for way, key in _CROSS.items():
            if pad.button(f"DPAD_{way}"):
                return key
        moved = {keys: pad.axis(name) for name, keys in _STICKS.items()}
        keys = max(moved, key=lambda one: abs(moved[one]))
        return keys[moved[keys] > 0] if abs(moved[keys]) > _HALF else ""
