"""A lab on this computer's loopback: labgrid's coordinator and exporter, an SSH server, and callers.

Everything lies in one folder and is ended with the lab; nothing of the computer's own SSH is used.
"""

import contextlib
import getpass
import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "labgrid"
ENOUGH_S = 60.0


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def sshd():
    """Path of the SSH server, None without one."""
    return shutil.which("sshd", path=os.pathsep.join((os.environ["PATH"], "/usr/sbin")))


class Lab:
    """A place `robot` on a bench's computer that is reached by SSH.

    Args:
        folder: for keys, logs and results.
        tools: folder of `labgrid-client` and its like.
    """

    def __init__(self, folder, tools):
        self.folder, self.tools = folder, tools
        self.bench = folder / "bench"
        self.bench.mkdir()
        shutil.copy(EXAMPLE / "keep_run.py", self.bench)
        self._processes = []
        self._coordinator, self._ssh = free_port(), free_port()
        self.environment = {
            **os.environ,
            "PATH": os.pathsep.join((str(tools), str(Path(sys.executable).parent), os.environ["PATH"])),
            "LG_COORDINATOR": f"127.0.0.1:{self._coordinator}",
            "LG_HOSTNAME": "loopback",
            "TMPDIR": str(folder / "tmp"),
        }
        (folder / "tmp").mkdir()

    def __enter__(self):
        try:
            self._begin()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for process in reversed(self._processes):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        for number in self.of_this_lab("ssh"):  # masters of callers that were killed outlive them
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        for log in sorted(self.folder.glob("*.log")):  # shown with a test that fails
            print(f"== {log.name}\n{log.read_text(errors='replace')}")

    def _start(self, name, *command, **changed):
        log = (self.folder / f"{name}.log").open("wb")
        with log:
            process = subprocess.Popen(
                [*map(str, command)],
                cwd=self.folder,
                env={**self.environment, **changed},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._processes.append(process)
        return process

    def _begin(self):
        for name in ("host", "id"):
            command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(self.folder / name)]
            subprocess.run(command, check=True)
        server = (
            f"Port {self._ssh}\nListenAddress 127.0.0.1\nHostKey {self.folder / 'host'}\nUsePAM no\n"
            f"AuthorizedKeysFile {self.folder / 'id.pub'}\nStrictModes no\nPidFile none\n"
            "PasswordAuthentication no\n"
        )
        (self.folder / "sshd_config").write_text(server)
        if os.getuid() == 0:
            Path("/run/sshd").mkdir(exist_ok=True)
        self._start("sshd", sshd(), "-D", "-e", "-f", self.folder / "sshd_config")
        self._start("agent", "ssh-agent", "-D", "-a", self.folder / "agent.socket")
        self.environment["SSH_AUTH_SOCK"] = str(self.folder / "agent.socket")
        wait_for((self.folder / "agent.socket").exists)
        subprocess.run(["ssh-add", "-q", str(self.folder / "id")], check=True, env=self.environment)
        self._start("coordinator", "labgrid-coordinator", "-l", self.environment["LG_COORDINATOR"])
        exporter = (EXAMPLE / "exporter.yaml").read_text()
        for given, here in (("192.168.0.20", "127.0.0.1"), ("robot", getpass.getuser()), ("22", self._ssh)):
            exporter = exporter.replace(f": {given}\n", f": {here}\n")
        (self.folder / "exporter.yaml").write_text(exporter)
        wait_for(lambda: self.client("places", check=False).returncode == 0)
        address = self.environment["LG_COORDINATOR"]
        self._start("exporter", "labgrid-exporter", "-c", address, "--name", "benchpc", "exporter.yaml")
        wait_for(lambda: "benchpc/bench/NetworkService" in self.client("resources").stdout)
        self.client("-p", "robot", "create")
        self.client("-p", "robot", "add-match", "benchpc/bench/NetworkService")
        self.client("-p", "robot", "set-tags", "robot=4wis4wid")

    def client(self, *words, check=True):
        """Call labgrid-client."""
        return subprocess.run(
            ["labgrid-client", *words],
            env=self.environment,
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=check,
            timeout=60,
        )

    def call(self, name, *command):
        """A caller of that name begins; its results go to a folder of its name, what it says to its log."""
        inner = {name: self.environment[name] for name in ("PATH", "LG_COORDINATOR", "LG_HOSTNAME")}
        inner["PYTHONPATH"] = os.environ.get("PYTHONPATH", "")
        given = " ".join(f"{key}={shlex.quote(value)}" for key, value in inner.items())
        remote = f"cd {shlex.quote(str(self.bench))} && env {given} python keep_run.py --silence 5"
        return self._start(
            name,
            sys.executable,
            EXAMPLE / "run_on_place.py",
            f"--remote={remote}",
            self.folder / name,
            *command,
            LG_USERNAME=name,
        )

    def says(self, name):
        """What a process has said so far."""
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def has_place(self):
        """HOST/USER that has the place, empty where it is free."""
        shown = self.client("-p", "robot", "show").stdout
        (line,) = (text for text in shown.splitlines() if text.strip().startswith("acquired:"))
        found = line.partition(":")[2].strip()
        return "" if found == "None" else found

    def of_this_lab(self, program):
        """Process ids of a program that names this lab's folder in its command line."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = path.read_bytes().decode(errors="replace").split("\0")
                if Path(words[0]).name == program and str(self.folder) in " ".join(words):
                    found.append(int(path.parent.name))
        return found


def wait_for(condition, limit_s=ENOUGH_S):
    """Return what the condition gives as soon as that is true."""
    end_s = time.monotonic() + limit_s
    while not (found := condition()):
        assert time.monotonic() < end_s, "it did not come to that"
        time.sleep(0.2)
    return found
