"""What a bench does for its fan, as a process that can be killed: has it kept, sets it, and is busy."""

import sys
import time

from hil.core.clock import MonotonicClock
from hil.core.errors import UsageError
from hil.fan_daemon.fallback_client import FailoverClient
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.spec import Spec


def tell(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main():
    kept = FailoverClient(Spec.from_json(sys.argv[1]), MonotonicClock(), say=tell)
    kept.open()
    while not kept.status().get("report"):
        time.sleep(0.02)
    for value in sys.argv[2:]:
        try:
            kept.set(SetPoint("duty", float(value)))
        except UsageError as error:
            tell(error)
    tell("ready")
    while True:
        sum(range(20_000))
        time.sleep(0.005)


if __name__ == "__main__":
    main()
