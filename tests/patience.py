"""Keys of a bench file for tests at the wire in which this computer's load must not count as silence.

An emulator that another program keeps from its core for a moment answers late: a chip does not.
"""

import tomli_w

from hil.config.loading import load_bench

PATIENT = {
    "safety.servo_stale_s": 2.0,
    "servos.fail_after_s": 5.0,
    "servos.reply_slack_s": 0.03,
    "loop.rate_hz": 50.0,
    "servos.prefetch": True,
    "imu.reply_timeout_s": 0.1,
    "imu.fail_after_s": 10.0,
}

FANLESS = {"adhesion": None, "thrust": None, "load_cells": None, "loop.rate_hz": 50.0}
"""For tests of something else, at half the usual rate: a fan is not waited for; the emulated robot is pressed
on its wall anyway."""


def patient_bench(folder, profile, **tables):
    """A bench file like a shipped profile, for a busy computer, without a fan; `tables` override it."""
    config = load_bench(profile, overrides={**PATIENT, **FANLESS, **tables})
    path = folder / "bench.toml"
    path.write_bytes(tomli_w.dumps(config.model_dump(mode="json", by_alias=True, exclude_none=True)).encode())
    return path
