#!/usr/bin/env bash
# Expected: Ctrl-C ends pytest with status 2, and with its summary, wherever it meets a test.
# Version: pytest 9.2.0 with CPython 3.11.7
# So it is: a jump back to the head of a loop may have no line in CPython 3.11, and signals are heeded there. Then
#   `tb_lineno` of that frame is None, pytest's report of the interrupt raises a TypeError, and pytest ends with status
#   1, a traceback and no summary. The loop here has no other place that heeds signals, so it happens each time.
# Source: code, _pytest/_code/code.py, TracebackEntry.lineno (`tb_lineno - 1`); seen 2026-11-29
# What to do: in a plugin, give such entries a line in `pytest_keyboard_interrupt(excinfo)`, before pytest's own: put
#   `types.TracebackType(tb_next, tb_frame, tb_lasti, line)` in their place.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet pytest==9.2.0
cat > test_rig.py <<'PY'
import signal

def test_waits_for_ever():
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.alarm(1)
    for _ in iter(int, 1):
        for ready in (True,):
            if ready:
                break
        else:
            ready = False
PY
status=0
venv/bin/python -m pytest -q test_rig.py 2> errors || status=$?
echo "status $status; $(tail -n 1 errors)"
test "$status" = 1
grep -q "TypeError: unsupported operand" errors
echo "still so"
