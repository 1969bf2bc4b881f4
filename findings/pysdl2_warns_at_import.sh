#!/usr/bin/env bash
# Expected: `import sdl2` is silent where the SDL that pysdl2-dll brings is used: it is the documented way to have one.
# Version: PySDL2 0.9.17, pysdl2-dll 2.32.0
# So it is: every import warns with a UserWarning that names the binaries. Where warnings are errors (`python -W error`,
#   pytest's `filterwarnings = error`) the import fails, and a program that reads a gamepad does not start.
# Source: code, sdl2/dll.py; seen 2026-11-29 with CPython 3.11
# What to do: filter that one message around the import, or set PYSDL2_DLL_PATH to a system's SDL2.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet PySDL2==0.9.17 pysdl2-dll==2.32.0
env -u PYSDL2_DLL_PATH venv/bin/python - <<'PY'
import warnings

with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    import sdl2

messages = [str(one.message) for one in told if one.category is UserWarning]
print("SDL", sdl2.SDL_MAJOR_VERSION, messages)
assert len(messages) == 1 and "pysdl2-dll" in messages[0], messages
PY
if env -u PYSDL2_DLL_PATH venv/bin/python -W error -c "import sdl2" 2> error.txt; then
    echo "it imports where warnings are errors"
    exit 1
fi
tail -n 1 error.txt
echo "still so"
