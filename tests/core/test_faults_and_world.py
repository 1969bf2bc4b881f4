"""The fault vocabulary and the order of events in the world."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench import supported_faults
from hil.config.loading import load_bench
from hil.core.errors import FaultNotSupportedError, UsageError
from hil.core.registry import kinds, which_device
from hil.fakes.world import NEVER_NS, Scheduled, VirtualClock, World
from hil.faults.fault import FINITE, OPTIONS, VOCABULARY, make_fault, option_of, parse_fault
from hil.faults.plan import DeviceFaults, FaultPlan
from tests.still_plant import StillPlant


class Ticker(Scheduled):
    def __init__(self, name, period_ns, log):
        self.name, self.period_ns, self.log, self.due_ns = name, period_ns, log, period_ns

    def next_due_ns(self):
        return self.due_ns

    def on_due(self, t_ns):
        self.log.append((t_ns, self.name))
        self.due_ns += self.period_ns


@given(
    st.sampled_from(VOCABULARY),
    st.integers(0, 1000),
    st.none() | st.integers(1, 1000),
    st.dictionaries(st.sampled_from(["duty", "value"]), st.integers(0, 1)),
)
def test_a_fault_reads_back_from_its_own_description(kind, at, duration, options):
    fault = make_fault("servo.drive_FL", kind, at=at, duration=duration, **options)
    assert parse_fault(str(fault)) == fault


@pytest.mark.parametrize(
    "spec", ["", "imu", "imu:stuck@", "imu:stuck@x", "imu:stuck@1+0", "imu:stuck,a=b", "imu:off@1+1e-9"]
)
def test_an_unreadable_fault_is_a_usage_error_that_shows_the_form(spec):
    with pytest.raises(UsageError, match="expected"):
        parse_fault(spec)


@pytest.mark.parametrize(
    ("spec", "reported"),
    [
        ("servos:intermittent@1,period_s=0", "period_s is 0; expected a number from 0.001 to 3600"),
        ("imu:intermittent,code=1.5", "code is 1.5; expected a whole number from 0 to 255"),
        ("imu:delayed,delay_s=-1", "delay_s is -1; expected a number from 0 to 60"),
        ("plant:adhesion_loss,factor=-5", "factor is -5; expected a number from 0 to 1"),
        ("tracker:wrong,scale=nan", "scale is nan; expected a number from -10 to 10"),
        ("lamp:wrong,brightness=inf", r"brightness is inf; expected a number from -1e\+09 to 1e\+09"),
    ],
)
def test_an_option_outside_its_range_is_refused_when_it_is_read(spec, reported):
    with pytest.raises(UsageError, match=reported) as refused:
        parse_fault(spec)
    device, kind = spec.split("@")[0].split(",")[0].split(":")
    assert str(refused.value).startswith(f"fault {device}:{kind}@")


@pytest.mark.parametrize("name", sorted(OPTIONS))
def test_both_ends_of_a_range_are_taken(name):
    kind, _, option = name.rpartition(":")
    kind = kind or "wrong"
    for value in (OPTIONS[name].least, OPTIONS[name].most):
        fault = make_fault("imu", kind, **{option: OPTIONS[name].text(value)})
        assert fault.option(option, 5.5) == value
        assert parse_fault(str(fault)) == fault
    with pytest.raises(UsageError, match=option):
        make_fault("imu", kind, **{option: OPTIONS[name].most * 1.001 + 1e-3})


def test_every_option_that_a_shipped_device_declares_has_a_range():
    for device, supported in supported_faults(load_bench("emulated")).items():
        for kind, options in supported.items():
            for option in options:
                assert option_of(kind, option) is not FINITE, (device, kind, option)


@pytest.mark.parametrize(
    ("word", "meant"), [("camera", "tracker"), ("trackr", "tracker"), ("fan", "adhesion"), ("zzz", None)]
)
def test_nouns_and_aliases_of_kinds_lead_to_their_devices(word, meant):
    assert which_device(word, kinds()) == (f"did you mean {meant}?" if meant else "")
    assert which_device(word, ["servos"]) == ""


def test_a_fault_acts_in_its_half_open_interval():
    fault = parse_fault("imu:stuck@2+3")
    assert [fault.active(t * 10**9) for t in (1, 2, 4, 5)] == [False, True, True, False]


def test_a_fault_takes_over_from_one_of_its_kind_that_began_earlier():
    plan = FaultPlan(
        [
            parse_fault(f"camera:wrong@{span},scale={scale}")
            for span, scale in (("4+2", 0.5), ("2", 0.9), ("8", 0.3))
        ]
    )
    found = {t: plan.find("camera", "wrong", t * 10**9) for t in (1, 3, 5, 7, 9)}
    assert {t: fault and fault.option("scale", 1.0) for t, fault in found.items()} == {
        1: None,
        3: 0.9,
        5: 0.5,
        7: 0.9,
        9: 0.3,
    }


def test_what_acts_once_acts_each_time_that_it_is_planned():
    """A jump is active for ever: the next one is not hidden by it."""
    faults = DeviceFaults(
        FaultPlan([parse_fault("camera:jump@2"), parse_fault("camera:jump@4")]),
        "camera",
        np.random.default_rng(0),
    )
    acted = [t for t in range(1, 8) if faults.first_activation("jump", t * 10**9) is not None]
    assert acted == [2, 4]


def test_unsupported_faults_and_unknown_devices_are_refused():
    plan = FaultPlan([parse_fault("imu:jump")])
    plan.declare("imu", {"stuck": ()})
    with pytest.raises(FaultNotSupportedError, match="cannot produce"):
        plan.check()
    with pytest.raises(
        FaultNotSupportedError, match=r"imu cannot produce the fault 'melt'; expected one of stuck$"
    ):
        plan.add(parse_fault("imu:melt"))
    with pytest.raises(FaultNotSupportedError, match="no emulated device"):
        plan.add(parse_fault("tracker:jump"))


@pytest.mark.parametrize(
    ("supported", "reported"),
    [
        ({"offf": ()}, r"device gap declares the fault 'offf'; expected one of off, .*did you mean off\?"),
        ({"off": (), "stuk": ("at",)}, r"device gap declares the fault 'stuk'; .*did you mean stuck\?"),
        (
            {"drop": "probability"},
            r"the fault 'drop' with the options 'probability'; expected a tuple of names",
        ),
        ({"drop": ("a b",)}, r"the fault 'drop' with the options \('a b',\); expected a tuple of names"),
    ],
)
def test_a_device_declares_only_faults_that_there_are(supported, reported):
    plan = FaultPlan()
    with pytest.raises(UsageError, match=reported):
        plan.declare("gap", supported)
    assert not plan.supported
    plan.declare("gap", {"drop": ("probability", "an_option_of_its_own")})


def test_parts_act_in_time_order_and_ties_by_registration():
    log = []
    world = World(StillPlant())
    world.add(Ticker("b", 30, log))
    world.add(Ticker("a", 20, log))
    VirtualClock(world).sleep_until_ns(60)
    assert log == [(20, "a"), (30, "b"), (40, "a"), (60, "b"), (60, "a")]
    assert world.plant.t_ns == 60
    assert world.now_ns == 60


def test_time_never_runs_backwards_and_sleeping_for_ever_is_refused():
    world = World(StillPlant())
    clock = VirtualClock(world)
    clock.sleep_until_ns(50)
    clock.sleep_until_ns(10)
    assert clock.now_ns() == 50
    with pytest.raises(UsageError):
        clock.sleep_until_ns(NEVER_NS)


def test_random_streams_depend_on_seed_and_name_only():
    first = World(StillPlant(), seed=3).rng("imu").standard_normal(4)
    np.testing.assert_array_equal(first, World(StillPlant(), seed=3).rng("imu").standard_normal(4))
    assert not np.array_equal(first, World(StillPlant(), seed=4).rng("imu").standard_normal(4))
    assert not np.array_equal(first, World(StillPlant(), seed=3).rng("can").standard_normal(4))


class Waker(Ticker):
    """Each time it acts, another part is to act 5 ns later."""

    def on_due(self, t_ns):
        super().on_due(t_ns)
        self.other.due_ns = t_ns + 5


class Woken(Ticker):
    def on_due(self, t_ns):
        self.log.append((t_ns, self.name))
        self.due_ns = NEVER_NS


def test_a_part_whose_plan_another_one_changes_acts_in_time():
    log = []
    world = World(StillPlant())
    waker, woken = Waker("a", 20, log), Woken("b", NEVER_NS, log)
    waker.other = woken
    world.add(waker)
    world.add(woken)
    world.advance_to(50)
    assert log == [(20, "a"), (25, "b"), (40, "a"), (45, "b")]
