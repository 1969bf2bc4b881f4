"""Runs the tests that depend on numbers as other processors would compute them.

numpy, OpenBLAS and the C library choose their code by what the processor can do, and each can be asked to do
without. A test that passes under all of these does not depend on the make of the processor.

    python tests/portable.py [--short]
"""

import json
import os
import subprocess
import sys
import time

AS_IT_IS = "as it is"
PROCESSORS = {
    AS_IT_IS: {},
    "x86-64 without AVX-512": {
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    },
    "x86-64 with the matrix products of an old one": {"OPENBLAS_CORETYPE": "Prescott"},
    "x86-64 without FMA and AVX2": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2"},
}
"""Variables of the environment that make one processor compute as another."""
NUMBERS = (
    "tests/recording",
    "tests/estimator",
    "tests/calibration",
    "tests/controller",
    "tests/procedures",
    "tests/kinematics",
    "tests/trajectories",
    "tests/core",
    "tests/bench",
    "tests/live",
)
"""What depends on numbers: recording and replay, estimators, calibration, controllers, loop, procedures."""
FEW = (
    "tests/recording/test_mcap_replay.py",
    "tests/recording/test_replay_agreement.py",
    "tests/recording/test_mcap_codec.py",
    "tests/live/test_live_virtual_replay.py",
    "tests/procedures/test_scripted_recordings.py",
    "tests/kinematics",
    "tests/trajectories",
)
"""The most telling of these within a minute; without the computer as it is, which `make test` looks at."""
OPTIONS = ("-q", "-n", "2", "--dist", "worksteal", "-m", "not long and not real_time and not alone")


def arithmetic(variables):
    """Fingerprint of the arithmetic in a process with these variables."""
    done = subprocess.run(
        [sys.executable, "-m", "hil", "info", "--json"],
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        check=True,
    )
    return json.loads(done.stdout)["arithmetic"]


def main(*words):
    """Run all of them; returns 1 where a test failed."""
    short = "--short" in words
    known, rows, failed = [], [], 0
    for name, variables in PROCESSORS.items():
        found = arithmetic(variables)
        if found in known:
            rows.append(f"{name}: the same arithmetic as one before on this computer, not run again")
            continue
        known.append(found)
        if short and name == AS_IT_IS:
            continue
        print(f"\n{name}: {found}", flush=True)
        start = time.monotonic()
        code = subprocess.call(
            [sys.executable, "-m", "pytest", *OPTIONS, *(FEW if short else NUMBERS)],
            env={**os.environ, **variables},
        )
        failed |= code != 0
        rows.append(f"{name}: {'failed' if code else 'passed'} in {time.monotonic() - start:.0f} s")
    print("", *rows, sep="\n")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
