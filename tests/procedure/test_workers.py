"""Work in other processes: results come in order, and every error arrives as the one that was raised."""

import pickle

import pytest

from hil.bench.third_party.call_timeout import CallTimeoutError
from hil.config.loading import NoSuchDevice
from hil.core.errors import HilError, SafetyStop, TrajectoryError
from hil.procedure.worker_processes import Workers


def every(kind):
    yield kind
    for below in kind.__subclasses__():
        yield from every(below)


def test_an_error_of_every_kind_survives_a_way_between_processes():
    assert {TrajectoryError, CallTimeoutError, NoSuchDevice, SafetyStop} <= set(every(HilError))
    for kind in every(HilError):
        error = kind.__new__(kind)
        HilError.__init__(error, "what is wrong", expected="this", remedy="do that")
        error.noted = 3.5
        there = pickle.loads(pickle.dumps(error))
        assert type(there) is kind
        assert (str(there), there.__dict__) == (str(error), error.__dict__), kind


def refused(number):
    if number == 2:
        raise TrajectoryError("too fast", t_s=1.5, quantity="wheel speed (m/s)", value=9.0, limit=3.5)
    return 10 * number


@pytest.mark.timeout(120)
def test_an_error_of_a_worker_is_the_error_of_the_procedure():
    with Workers(2) as workers:
        results = workers.at_once(refused, [0, 1, 2])
        assert [next(results), next(results)] == [0, 10]
        with pytest.raises(TrajectoryError, match="too fast") as caught:
            next(results)
    assert (caught.value.t_s, caught.value.limit) == (1.5, 3.5)
