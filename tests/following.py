"""How tests read a driver in virtual time: again and again for a while, as a loop does."""


def follow(bench, duration_s, period_ns=10_000_000):
    """The samples of `bench.driver`, read every `period_ns` for some seconds of `bench.clock`."""
    samples, t_ns = [], bench.clock.now_ns()
    end_ns = t_ns + round(duration_s * 1e9)
    while t_ns < end_ns:
        t_ns += period_ns
        bench.clock.sleep_until_ns(t_ns)
        samples += bench.driver.read()
    return samples


def until(bench, t_s):
    """As `follow`, until an instant of bench time."""
    return follow(bench, t_s - bench.clock.now_ns() * 1e-9)


def kinds(samples):
    return [s.status for s in samples]
