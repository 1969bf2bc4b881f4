"""A program that stood still blames itself, not devices that nothing asked meanwhile."""

import pytest

import hil
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceTimeoutError, SafetyStop
from hil.core.interfaces import Sensor
from hil.core.registry import kinds
from hil.loop.alignment import Alignment
from hil.loop.control_loop import ControlLoop
from hil.loop.device_set import DeviceSet
from hil.loop.pipeline import ControlPipeline
from hil.loop.supervisor import Supervisor

NEVER_ANSWER = {"teensy"}
MODELS = [
    (kind.name, model.name)
    for kind in kinds().values()
    for model in kind.models
    if kind.name != "servos" and model.emulate is not None and model.name not in NEVER_ANSWER
]


@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_time_in_which_nothing_asked_is_no_silence_of_the_device(tmp_path, kind, model):
    path = tmp_path / "bench.toml"
    path.write_text(f'schema = 1\nname = "x"\n[{kind}]\nmodel = "{model}"\nbackend = "emulated"\n')
    with hil.open_bench(path, faults=[f"{kind}:off@6"]) as bench:
        device, fail_s = bench.devices.get(kind), getattr(bench.config, kind).fail_after_s
        clock = bench.clock

        def asked_for(seconds):
            end_ns = clock.now_ns() + nanoseconds(seconds)
            while clock.now_ns() < end_ns:
                device.read()
                clock.sleep_until_ns(clock.now_ns() + 10_000_000)

        assert clock.now_ns() < 6_000_000_000
        clock.sleep_until_ns(5_900_000_000)
        asked_for(0.3)
        clock.sleep_until_ns(clock.now_ns() + nanoseconds(fail_s + 3.0))
        asked_for(0.2)
        with pytest.raises(DeviceTimeoutError):
            asked_for(fail_s + 1.0)


class Leaping(Clock):
    """A clock that leaps by 5 s before the fourth cycle, as after SIGSTOP and SIGCONT."""

    def __init__(self):
        self.t_ns, self.cycles = 0, 0

    def now_ns(self):
        return self.t_ns

    def sleep_until_ns(self, t_ns):
        self.t_ns = max(self.t_ns, t_ns)
        self.cycles += 1
        if self.cycles == 4:
            self.t_ns += 5_000_000_000

    def schedule(self, task, due_ns):
        return lambda: None

    def wall_offset(self):
        return None


class Impatient(Sensor):
    """A sensor of a package whose timeout knows nothing of pauses."""

    name = "imu"

    def __init__(self, clock, *, dead_at=10**9):
        self.clock, self.read_ns, self.reads, self.dead_at = clock, 0, 0, dead_at

    def open(self):
        pass

    def close(self):
        pass

    def identity(self):
        return {}

    def read(self):
        self.reads += 1
        waited_ns, self.read_ns = self.clock.now_ns() - self.read_ns, self.clock.now_ns()
        if waited_ns > 1_000_000_000 or self.reads >= self.dead_at:
            raise DeviceTimeoutError("imu", "nothing usable for 5.0 s", remedy="check power, wiring")
        return ()


def looped(clock, sensor):
    with hil.open_bench("emulated_floor") as bench:
        pipeline = ControlPipeline(
            Supervisor(bench.make_pipeline(None).supervisor.limits),
            Alignment(bench.model.alignment_parameters),
            bench.model.make_estimator("ekf"),
        )
        pipeline.reset(bench.start_state())
    return ControlLoop(DeviceSet(clock, None, {"imu": sensor}), clock, pipeline)


def test_a_loop_that_stood_still_names_itself_before_a_device_that_gave_up():
    clock = Leaping()
    with pytest.raises(SafetyStop, match=r"stood still for 5\.0 s.*then imu: nothing usable") as stop:
        looped(clock, Impatient(clock)).run(lambda record: record.cycle > 10)
    assert stop.value.reason == "held_up"


def test_a_device_that_gives_up_without_a_pause_is_named_itself():
    clock = Leaping()
    with pytest.raises(DeviceTimeoutError, match="nothing usable"):
        looped(clock, Impatient(clock, dead_at=3)).run(lambda record: record.cycle > 10)
