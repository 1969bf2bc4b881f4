import numpy as np

from hil.core.signals import ServoSetpoint


def test_it_opens_reads_and_moves(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    t_ns = bench.clock.now_ns()
    for _ in range(100):
        (sample,) = bench.driver.read()
        bench.driver.command(ServoSetpoint(np.array([1.0, -1.0, 2.0, 3.0]), np.array([0.5, -0.5, 0.1, 0.0])))
        t_ns += 10_000_000
        bench.clock.sleep_until_ns(t_ns)
    assert sample.ok
    np.testing.assert_allclose(sample.velocity_rad_s[:4], [1, -1, 2, 3], atol=0.05)
    np.testing.assert_allclose(sample.position_rad[4:], [0.5, -0.5, 0.1, 0.0], atol=0.005)
