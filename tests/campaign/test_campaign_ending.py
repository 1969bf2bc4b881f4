"""Work on Dask that a signal ends: it strikes where Dask is not at work, and no job is left behind."""

import os
import signal
import time
from contextlib import ExitStack

import pytest

from hil.campaign.dask_run import DeferredSignals, close_once, spread


def strike(number=signal.SIGINT):
    os.kill(os.getpid(), number)


def test_a_signal_strikes_when_dask_is_no_longer_at_work():
    former = signal.getsignal(signal.SIGINT)
    with DeferredSignals() as deferred:
        strike()
        with pytest.raises(KeyboardInterrupt), deferred.delivered():
            pytest.fail("it was forgotten")
        with pytest.raises(KeyboardInterrupt), deferred.delivered():
            strike()
    assert signal.getsignal(signal.SIGINT) is former


def test_a_second_signal_strikes_at_once():
    with DeferredSignals():
        strike()
        with pytest.raises(KeyboardInterrupt):
            strike()


def test_a_signal_is_handled_as_before_or_not_at_all():
    taken = []
    former = signal.signal(signal.SIGTERM, lambda number, _: taken.append(number))
    try:
        with DeferredSignals() as deferred:
            strike(signal.SIGTERM)
            assert not taken
            with deferred.delivered():
                assert taken == [signal.SIGTERM]
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        with DeferredSignals() as deferred, deferred.delivered():
            strike(signal.SIGTERM)
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, former)


def test_a_second_signal_does_not_break_into_the_end_of_the_workers():
    before, ended = signal.getsignal(signal.SIGINT), ExitStack()
    ended.callback(strike)
    close_once(ended)
    assert signal.getsignal(signal.SIGINT) is before


def job(number):
    """As short as it takes for some to end while the client leaves."""
    time.sleep(0.01)
    return number


def test_jobs_are_taken_back_before_the_client_leaves(tmp_path):
    """Of each that ended afterwards the scheduler would log that it cannot tell the client."""
    distributed = pytest.importorskip("distributed", reason="Dask (the extra campaign) is not installed")
    done = []

    def interrupted(number):
        done.append(number)
        if len(done) == 5:
            raise KeyboardInterrupt

    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        dashboard_address=None,
        memory_limit=0,
        local_directory=str(tmp_path),
    ) as cluster:
        with pytest.raises(KeyboardInterrupt):
            spread(
                job,
                range(400),
                lost=lambda number, reason: number,
                done=interrupted,
                scheduler=cluster.scheduler_address,
            )
        assert not cluster.scheduler.tasks
