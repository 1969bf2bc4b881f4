"""The periodic look at mode and system status rides on the prefetched burst: it takes no cycle any time."""

from hil.core.signals import Status

PERIOD_NS = 10_000_000


def test_no_read_waits_for_the_check(imu_bench):
    bench = imu_bench(config={"prefetch": True, "check_period_s": 0.1}, overrun_probability=0.0)
    bench.driver.open()
    spent = []
    for _ in range(200):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + PERIOD_NS)
        before_ns = bench.clock.now_ns()
        bench.driver.read()
        spent.append(bench.clock.now_ns() - before_ns)
    assert max(spent[5:]) < 400_000


def test_a_chip_that_has_lost_its_mode_is_still_found(imu_bench):
    bench = imu_bench(
        "imu:reset@1", config={"prefetch": True, "check_period_s": 0.3}, overrun_probability=0.0
    )
    bench.driver.open()
    found = []
    for _ in range(300):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + PERIOD_NS)
        found += [s.status for s in bench.driver.read()]
    assert Status.RESET in found
    assert found[-50:] == [Status.OK] * 50
