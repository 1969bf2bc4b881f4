"""A process that has imported what the `hil` command uses, and done nothing: commands are forked from it.

    python tests/warm_template.py DESCRIPTOR

A request on the Unix socket is a pickled dict; with it come the descriptors of the command's three streams
and one that is reported its wait status. What is forked has folder, environment, arguments and session of
its own, signals as a program begins with them, and ends as every interpreter does. What such a command starts
itself (the emulator of its devices) is forked from the same process. See tests/warm.py.
"""

import contextlib
import gc
import importlib
import os
import pickle
import runpy
import select
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np

MODULES = (
    "hil.bench.opening",
    "hil.bench.doctor.examination",
    "hil.calibration.calibrate",
    "hil.calibration.residual_pass",
    "hil.fakes.emulated_can",
    "hil.drivers.encoders",
    "hil.drivers.load_cells.hx711.can_driver",
    "hil.estimator",
    "hil.live",
    "hil.procedure",
    "hil.recording.mcap_writer",
    "hil.loop.realtime",
    "logging.config",
    "pytest",
)
"""What opening a bench imports only when it comes to it; the commands themselves are named by the package."""
REQUEST_BYTES = 1 << 20
BESIDE = "PYTHONPATH"
STATUS = struct.Struct("i")


def prepare():
    """Import, load the machine code of the emulated robot, and keep both from the garbage collector."""
    from hil.cli import COMMANDS, cli
    from hil.config.robot import RobotConfig
    from hil.core.registry import kinds
    from hil.fakes.plant import make_plant

    for name in COMMANDS:
        cli.get_command(None, name)
    for module in MODULES:
        importlib.import_module(module)
    for kind in kinds().values():
        for model in kind.models:
            importlib.import_module(model.emulate.__module__)
    make_plant(RobotConfig(), rng=np.random.default_rng(0))
    gc.collect()
    gc.freeze()


def report(pid, status):
    """Tell who waits for a command how it ended."""
    ended = os.waitpid(pid, 0)[1]
    with contextlib.suppress(BrokenPipeError):  # who started it is gone
        os.write(status, STATUS.pack(ended))
    os.close(status)


def serve(control, searched, listener):
    """Fork commands until the socket is closed; returns in each of them, with the words to run.

    Commands ask for further ones by the listening socket.
    """
    poll, reported, asking = select.poll(), {}, {control.fileno(): control}
    for one in (control, listener):
        poll.register(one, select.POLLIN)
    while True:
        for descriptor, _ in poll.poll():
            if descriptor in reported:
                poll.unregister(descriptor)
                os.close(descriptor)
                report(*reported.pop(descriptor))
                continue
            if descriptor == listener.fileno():
                one = listener.accept()[0]
                asking[one.fileno()] = one
                poll.register(one, select.POLLIN)
                continue
            one = asking[descriptor]
            data, streams, _, _ = received(one)
            if not data:
                if one is control:
                    sys.exit()
                poll.unregister(one)
                asking.pop(descriptor).close()
                continue
            pid = os.fork()
            if not pid:
                return become(pickle.loads(data), streams, searched)
            with contextlib.suppress(BrokenPipeError):
                one.send(STATUS.pack(pid))
            for stream in streams[:3]:
                os.close(stream)
            ended = os.pidfd_open(pid)
            reported[ended] = pid, streams[3]
            poll.register(ended, select.POLLIN)


def received(one):
    """What a socket got; nothing where who asked was killed."""
    try:
        return socket.recv_fds(one, REQUEST_BYTES, 4)
    except ConnectionResetError:
        return b"", [], 0, None


def become(request, streams, searched):
    """Be the command: everything that a process inherits or is given, but what is imported."""
    for number, stream in enumerate(streams[:3]):
        os.dup2(stream, number)
    os.closerange(3, max(streams) + 1)
    if request["session"]:
        os.setsid()
    os.chdir(request["folder"])
    given = dict(os.environ)
    os.environ.clear()
    os.environ.update(request["environment"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    own, wanted = (places(environment, request["folder"]) for environment in (given, os.environ))
    sys.path[:] = [os.getcwd(), *wanted, *(place for place in searched if place not in own)]
    if own != wanted:
        forget_packages()
    sys.argv[:] = ["-m", *request["words"][1:]]
    return request["words"][0]


def places(environment, folder):
    """Folders that modules are looked for in by an environment; `-m` looks in the present one anyway."""
    return [place for place in environment.get(BESIDE, "").split(os.pathsep) if place not in ("", folder)]


def forget_packages():
    """Packages of devices are looked for anew: others lie beside this command."""
    from hil.config.bench import bench_model
    from hil.core.registry import kinds

    importlib.invalidate_caches()
    for cached in (kinds, bench_model):
        cached.cache_clear()


def popen(template):
    """What stands for `Popen` in a command: it asks this process, too. No `tests` stays imported for that."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from tests import warm

    del sys.path[0]
    for name in [name for name in sys.modules if name.partition(".")[0] == "tests"]:
        del sys.modules[name]
    warm.Warm.template = warm.Asked(template, dict(os.environ))
    return warm.Warm


def main(descriptor):
    """Serve; in a forked command, return its module."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    searched = sys.path[1:]
    sys.path[:] = searched
    prepare()
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(f"\0hil-warm-{os.getpid()}")
    listener.listen()
    warm = popen(listener.getsockname())
    control = socket.socket(fileno=int(descriptor))
    control.send(b"!")
    module = serve(control, searched, listener)
    subprocess.Popen = warm
    return module


if __name__ == "__main__":
    module = main(sys.argv[1])
    runpy.run_module(module, run_name="__main__", alter_sys=True)
