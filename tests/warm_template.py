"""A process that has imported what the `hil` command uses, and done nothing: commands are forked from it.

    python tests/warm_template.py DESCRIPTOR

A request on the Unix socket is a pickled dict; with it come the descriptors of the command's three streams
and one that is reported its wait status. What is forked has folder, environment, arguments and session of its
own, signals as a program begins with them, and ends as every interpreter does. See tests/warm.py.
"""

import gc
import importlib
import os
import pickle
import runpy
import select
import signal
import socket
import struct
import sys

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


def serve(control, searched):
    """Fork commands until the socket is closed; returns in each of them, with the words to run."""
    poll, reported = select.poll(), {}
    poll.register(control, select.POLLIN)
    while True:
        for descriptor, _ in poll.poll():
            if descriptor in reported:
                poll.unregister(descriptor)
                pid, status = reported.pop(descriptor)
                os.close(descriptor)
                os.write(status, STATUS.pack(os.waitpid(pid, 0)[1]))
                os.close(status)
                continue
            data, streams, _, _ = socket.recv_fds(control, REQUEST_BYTES, 4)
            if not data:
                sys.exit()
            pid = os.fork()
            if not pid:
                return become(pickle.loads(data), streams, searched)
            control.send(STATUS.pack(pid))
            for stream in streams[:3]:
                os.close(stream)
            ended = os.pidfd_open(pid)
            reported[ended] = pid, streams[3]
            poll.register(ended, select.POLLIN)


def become(request, streams, searched):
    """Be the command: everything that a process inherits or is given, but what is imported."""
    for number, stream in enumerate(streams[:3]):
        os.dup2(stream, number)
    os.closerange(3, max(streams) + 1)
    if request["session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.path[:] = [os.getcwd(), *searched]
    sys.argv[:] = ["-m", *request["words"][1:]]
    return request["words"][0]


def main(descriptor):
    """Serve; in a forked command, run its module."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    searched = sys.path[1:]
    sys.path[:] = searched
    prepare()
    control = socket.socket(fileno=int(descriptor))
    control.send(b"!")
    return serve(control, searched)


if __name__ == "__main__":
    module = main(sys.argv[1])
    runpy.run_module(module, run_name="__main__", alter_sys=True)
