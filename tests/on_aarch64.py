"""Runs the bench on an emulated aarch64 computer, and has it and this one verify each other's recordings.

`make test-aarch64` starts it. It needs Debian on x86-64, the network, 3 GB in the folder for temporary
files and about half an hour; it needs no rights and changes nothing on this computer. qemu, Python and the C
library are Debian's packages, unpacked into a temporary folder that is removed at the end, also after Ctrl-C.
Every other package is the aarch64 wheel of `requirements/ci.lock`, checked by its hash.

There run `hil info`, a short drive on emulated devices, `--verify` of the drive that this computer has
recorded, and the tests of recording and estimator; here `--verify` of the drive recorded there. Both verdicts
have to be `agrees`. Of the tests those in LEFT_OUT are not run: they would take longest. Nor are those that
judge a clock: the times of an emulated processor say nothing of a real one's.

    python tests/on_aarch64.py [TESTS]
"""

import contextlib
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("qemu-user-static:amd64", "python3:arm64", "libstdc++6:arm64", "libgomp1:arm64")
PROCESSOR = "cortex-a76"
"""What qemu 7.2 has that is next to a Jetson Orin's Cortex-A78AE: NEON, no SVE."""
GLIBC = "2_35"
"""The oldest C library that wheels may ask for, of Ubuntu 22.04: what installs here installs on a Jetson."""
DRIVE = (
    "run",
    "wall_tracking",
    "--emulate",
    "all",
    "--seed",
    "1",
    "--set",
    'cases=["x_line"]',
    "--set",
    'feedbacks=["ekf", "ukf"]',
    "--set",
    "optimal=false",
    "--set",
    "length_m=0.3",
    "--set",
    "duration_s=6",
)
TESTS = ("tests/recording", "tests/estimator")
LEFT_OUT = (
    "tests/estimator/test_estimator_consistency.py",
    "tests/estimator/test_odometry_covariance.py",
    "tests/estimator/test_estimator_tuning.py",
    "tests/estimator/test_estimator_beside_wpimath.py",
    "tests/core/test_jit.py",
)
"""Statistics over many drives, and one that compiles everything several times."""
VIRTUAL = "not long and not real_time and not alone"
_APT = """
APT::Architecture "arm64";
APT::Architectures { "arm64"; "amd64"; };
APT::Install-Recommends "false";
APT::Sandbox::User "root";
Dir::State "FOLDER/state";
Dir::State::status "FOLDER/state/status";
Dir::Cache "FOLDER/cache";
"""


class StepFailed(Exception):
    """What a step found wrong, in a sentence."""


def run(*command: str | Path, kept: bool = False, **environment: str | Path) -> str:
    """Run a command to its end, with all that it starts; returns what it printed where that is kept."""
    process = subprocess.Popen(
        [*map(str, command)],
        cwd=ROOT,
        text=True,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        stdout=subprocess.PIPE if kept else None,
        env=os.environ | {name: str(value) for name, value in environment.items()},
    )
    try:
        printed = process.communicate()[0] or ""
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
    if process.returncode:
        raise StepFailed(f"exit code {process.returncode} of {' '.join(map(str, command))} {printed[-2000:]}")
    return printed


@dataclass(frozen=True)
class Computer:
    """Where the bench runs: a Python, and what its environment names beside this one's.

    Args:
        python: interpreter, or a script that starts it.
        environment: variables.
        out: folder of its drive.
    """

    python: Path
    environment: dict[str, Path | str]
    out: Path

    def python_m(self, *words: str | Path, kept: bool = True) -> str:
        """Run a module there; returns what it printed."""
        return run(self.python, "-m", *words, kept=kept, **self.environment)

    def drive(self) -> str:
        """Drive up the wall with feedback of EKF and of UKF; returns the verdict."""
        return self.python_m("hil", *DRIVE, "--out", self.out).strip().splitlines()[-3]

    def verify(self, other: "Computer") -> str:
        """Verify what the other has recorded; returns the largest difference of a position."""
        largest = []
        for recording in sorted(other.out.glob("*.mcap")):
            found = json.loads(self.python_m("hil", "replay", recording, "--verify", "--json"))
            print(f"{recording.name}: {found['verdict']}, largest differences {found['largest']}")
            if found["verdict"] != "agrees":
                raise StepFailed(f"{recording.name}: {found['verdict']}")
            largest.append(found["largest"]["position_m"])
        if not largest:
            raise StepFailed(f"no recording in {other.out}")
        return f"agrees; {len(largest)} recordings, positions within {max(largest):.1g} m"


class Emulated:
    """The parts of the emulated computer, in one folder.

    Args:
        folder: holds all of it.
    """

    def __init__(self, folder: Path) -> None:
        self.root, self._apt = folder / "root", folder / "apt"
        environment = {
            "PYTHONPYCACHEPREFIX": folder / "pycache",
            "PYTHONDONTWRITEBYTECODE": "",
            "NUMBA_CACHE_DIR": folder / "numba",
        }
        self.computer = Computer(folder / "python", environment, folder / "drive_there")

    def unpack(self) -> str:
        """Fetch Debian's packages by an apt that knows of no installed one, and unpack them."""
        for needed in ("state/lists/partial", "cache/archives/partial"):
            (self._apt / needed).mkdir(parents=True)
        (self._apt / "state/status").touch()
        config = self._apt / "apt.conf"
        config.write_text(_APT.replace("FOLDER", str(self._apt)))
        run("apt-get", "-qq", "update", APT_CONFIG=config)
        run("apt-get", "-qq", "install", "--yes", "--download-only", *PACKAGES, kept=True, APT_CONFIG=config)
        archives = sorted((self._apt / "cache/archives").glob("*.deb"))
        print("unpacked into a temporary folder:", *(path.stem.replace("%3a", ":") for path in archives))
        for archive in archives:
            run("dpkg-deb", "--extract", archive, self.root)
        shutil.rmtree(self._apt)
        return f"{len(archives)} packages"

    def install(self) -> str:
        """Install the wheels, and have what starts a child process start it by qemu, too."""
        python = (self.root / "usr/bin/python3").readlink().name
        wheels = self.root / "usr/lib/python3/dist-packages"
        uv = (sys.executable, "-m", "uv", "pip", "install", "--quiet", "--target", wheels, "--no-deps")
        run(
            *uv,
            "--require-hashes",
            "--only-binary",
            ":all:",
            "-r",
            "requirements/ci.lock",
            "--python-version",
            python.removeprefix("python"),
            "--python-platform",
            f"aarch64-manylinux_{GLIBC}",
        )
        run(*uv, "--no-build-isolation", "--editable", ROOT)
        qemu = self.root / "usr/bin/qemu-aarch64-static"
        started = self.computer.python
        words = f'"{qemu}" -cpu {PROCESSOR} -L "{self.root}" "{self.root}/usr/bin/{python}"'
        started.write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        started.chmod(0o755)
        (wheels / "started_by_qemu.pth").write_text(f"import sys; sys.executable = {str(started)!r}\n")
        return run(qemu, "--version", kept=True).splitlines()[0] + ", " + self._version()

    def _version(self) -> str:
        code = "import platform as p; print('Python', p.python_version(), *p.libc_ver(), p.machine())"
        return run(self.computer.python, "-c", code, kept=True, **self.computer.environment).strip()

    def info(self) -> str:
        """`hil info` there has to name an aarch64 and its wheels' versions."""
        found = json.loads(self.computer.python_m("hil", "info", "--json"))
        arithmetic = found["arithmetic"]
        print(json.dumps(arithmetic))
        if arithmetic["machine"] != "aarch64":
            raise StepFailed(f"it calls itself {arithmetic['machine']}")
        lacking = [name for name, there in found["extras"].items() if not there]
        shown = (f"{name} {arithmetic[name]}" for name in ("numpy", "blas", "libm", "numba"))
        return f"{', '.join(shown)}; extras but {', '.join(lacking)}"

    def test(self, *wanted: str) -> str:
        """Run pytest there, on two cores; each test may take as long as it does."""
        left_out = [f"--ignore={name}" for name in LEFT_OUT]
        options = ("-q", "-p", "no:cacheprovider", "-n", "2", "--timeout", "7200", "-m", VIRTUAL)
        self.computer.python_m("pytest", *options, *left_out, *(wanted or TESTS), kept=False)
        return "passed"


@contextlib.contextmanager
def timed(name: str, results: list[tuple[str, str, float]]) -> Iterator[list[str]]:
    """Name a step that begins, and note how it ended: with what is put into the list."""
    print(f"== {name}", flush=True)
    begin, said = time.monotonic(), ["interrupted"]
    try:
        yield said
    except (StepFailed, OSError, KeyError, ValueError) as error:
        said[:] = [f"FAILED: {error}"]
    finally:
        results.append((name, said[0], time.monotonic() - begin))
        print(f"   {said[0]} ({results[-1][2]:.0f} s)", flush=True)


def steps(folder: Path, tests: tuple[str, ...]) -> dict[str, Callable[[], str]]:
    """What is done in which order, by name."""
    emulated = Emulated(folder)
    there, here = (
        emulated.computer,
        Computer(Path(sys.executable), {"PYTHONPATH": ROOT}, folder / "drive_here"),
    )
    return {
        "Debian's packages": emulated.unpack,
        "wheels of the lock": emulated.install,
        "hil info there": emulated.info,
        "drive here": here.drive,
        "drive there": there.drive,
        "the drive of here, verified there": lambda: there.verify(here),
        "the drive of there, verified here": lambda: here.verify(there),
        "tests there": lambda: emulated.test(*tests),
    }


def main(*tests: str) -> int:
    """Take all steps and print the table of them; returns 1 where one failed.

    Without the first two nothing else is tried.
    """
    if platform.system() != "Linux" or platform.machine() != "x86_64" or shutil.which("apt-get") is None:
        print("an emulated aarch64 computer is made on Debian on x86-64; on aarch64 itself: make test")
        return 2
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    results: list[tuple[str, str, float]] = []
    with tempfile.TemporaryDirectory(prefix="hil_aarch64_") as folder:
        for number, (name, step) in enumerate(steps(Path(folder), tests).items()):
            with timed(name, results) as said:
                said[0] = step()
            if number < 2 and results[-1][1].startswith("FAILED"):
                break
    print(f"\n{'step':34} {'s':>6}  result")
    for name, said_of_it, seconds in results:
        print(f"{name:34} {seconds:6.0f}  {said_of_it}")
    return int(any(said_of_it.startswith("FAILED") for _, said_of_it, _ in results))


if __name__ == "__main__":
    try:
        sys.exit(main(*sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
