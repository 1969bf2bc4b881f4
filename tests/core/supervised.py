"""A supervisor that is given the samples and the estimate of one cycle after the other."""

from hil.core.signals import Inputs, Measurements
from hil.loop.supervisor import Supervisor


class Supervised(Supervisor):
    """Returns the events of each stage, and keeps the inflation of the latest cycle."""

    cycle = None

    def check(self, inputs, measurements=None):
        self.cycle = self.begin(inputs, measurements or Measurements(inputs.cycle, inputs.t_ns))
        try:
            self.check_samples(self.cycle)
        finally:
            self.inflation = self.cycle.inflation
        return tuple(self.cycle.events)

    def guard(self, state, reference=None):
        cycle, self.cycle = self.cycle, None
        if cycle is None:
            cycle = self.begin(Inputs(0, state.t_ns), Measurements(0, state.t_ns))
        before = len(cycle.events)
        cycle.state, cycle.reference = state, reference
        self.check_estimate(cycle)
        return tuple(cycle.events[before:])
