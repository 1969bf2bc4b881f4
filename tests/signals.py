"""Signals as a program begins with them, however the tests were started.

`nohup` leaves SIGHUP ignored, a shell SIGINT and SIGQUIT of what runs in its background, others leave signals
blocked: all of that would be handed on to every command that a test starts.
"""

import signal

_IGNORED_BY_PYTHON = {signal.SIGPIPE, getattr(signal, "SIGXFSZ", signal.SIGPIPE)}


def as_a_program_begins():
    """Heed every signal that this process was started to ignore, and block none."""
    for number in signal.valid_signals() - _IGNORED_BY_PYTHON:
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
