"""A bench ready to use: configuration, devices, clock and loop put together.

The only package that knows both drivers and fakes. `with open_bench("emulated") as bench:` gives a
script the same devices, clock and loop as the command line and the procedures have.
"""

from hil.bench.bench import Bench
from hil.bench.emulation import open_emulation
from hil.bench.opening import open_bench
from hil.bench.settings import alignment_parameters, safety_limits

__all__ = ["Bench", "alignment_parameters", "open_bench", "open_emulation", "safety_limits"]
