"""Cycle records for the tests of recordings: plausible ones by number, arbitrary ones by hypothesis."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from hypothesis import strategies as st

from hil.core.signals import (
    AdhesionSample,
    CycleRecord,
    EncoderSample,
    Event,
    GyroMeasurement,
    ImuSample,
    Inputs,
    LoadCellSample,
    Measurements,
    MocapSample,
    PoseMeasurement,
    Reference,
    RobotState,
    ServoHealth,
    ServoSample,
    ServoSetpoint,
    Stamp,
    Status,
    ThrustSample,
    TrackerSample,
    WheelMeasurement,
    WheelSetpoint,
)

MAPPING = """
schema = 2
[wheels]
topic = "/wheels"
drive = ["w1", "w2", "w3", "w4"]
steer = ["s1", "s2", "s3", "s4"]
drive_sign = [1, 1, -1, -1]
[truth]
topic = "/vicon"
"""
"""Of another robot's bag, whose right wheels count backwards."""
PERIOD_NS = 10_000_000
OK8, OK4 = (Status.OK,) * 8, (Status.OK,) * 4


@cache
def driving_record(k: int) -> CycleRecord:
    """Cycle `k` of a robot that drives upwards at 0.05 m/s, with all devices, 100 Hz."""
    t_ns = k * PERIOD_NS
    t_s = t_ns / 1e9
    stamp = Stamp(t_ns, t_ns + 300_000, k)
    noise = np.random.default_rng(k).normal(scale=1e-3, size=64)
    angle = np.r_[np.full(4, t_s), np.zeros(4)] + noise[:8]
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    pose = np.array([0.05 * t_s, 0.1, 0.01])
    twist = np.array([0.05, 0.0, 0.0])
    wheels = WheelMeasurement(stamp, angle[:4], np.ones(4) + noise[8:12], angle[4:], (True,) * 4)
    camera_stamps = (Stamp(t_ns - 5_000_000, t_ns, 2 * k), Stamp(t_ns, t_ns + 1, 2 * k + 1))
    position = np.r_[pose[:2], 0.0]
    return CycleRecord(
        cycle=k,
        deadline_ns=t_ns,
        start_ns=t_ns + 20_000,
        inputs=Inputs(
            cycle=k,
            t_ns=t_ns,
            servos=(ServoSample(stamp, angle, np.ones(8), noise[12:20], OK8),),
            health=(ServoHealth(stamp, np.full(8, 12.0), np.full(8, 40.0), OK8),) if k % 100 == 0 else (),
            encoders=(EncoderSample(stamp, noise[20:24], OK4, (1, 2, 3, 4)),),
            imu=(ImuSample(stamp, upright, noise[24:27], noise[27:30], np.array([9.8, 0, 0]), (3, 3, 3, 3)),),
            tracker=tuple(
                TrackerSample(s, position, upright, np.r_[twist[:2], 0.0], noise[30:33], 3)
                for s in camera_stamps
            ),
            mocap=(MocapSample(stamp, position + noise[33:36], upright, True, 0.004, 2e-4),),
            adhesion=(AdhesionSample(stamp, 30_000.0, 0.8, 37.0, 30.0, 22.8, 45.0, 40.0),),
            thrust=(ThrustSample(stamp, 0.75, math.nan),),
            load_cells=(LoadCellSample(stamp, 22.0 + noise[36:38], (Status.OK,) * 2, (440_000, 441_000)),),
        ),
        measurements=Measurements(
            cycle=k,
            t_ns=t_ns,
            wheels=(wheels,),
            gyro=(GyroMeasurement(stamp, float(noise[36]), float(noise[37]), noise[38:40]),),
            tracker=tuple(PoseMeasurement(s, "tracker", pose, 3, True) for s in camera_stamps),
            mocap=(PoseMeasurement(stamp, "mocap", pose + noise[40:43], 3, True),),
        ),
        state=RobotState(
            t_ns,
            pose + noise[43:46],
            twist,
            np.diag(np.full(6, 1e-4)),
            {"nis_wheels": 3.1 + float(noise[46]), "odometry_x_m": 0.05 * t_s},
        ),
        reference=Reference(t_s, pose, twist, np.zeros(3)),
        setpoint=WheelSetpoint(np.ones(4), np.zeros(4)),
        command=ServoSetpoint(np.ones(4), np.zeros(4)),
        events=(Event(t_ns, "warning", "imu", "stale for 0.5 s"),) if k == 3 else (),
        timing_ns={"read": 500_000 + k, "decide": 300_000, "write": 100_000, "lateness": 20_000},
        truth={"pose": pose, "slipping": False, "note": None, "wheels": (1, 2.5)} if k % 2 else None,
    )


def doubles(*shape: int) -> st.SearchStrategy[np.ndarray]:
    """Arrays of arbitrary 64-bit patterns: every NaN, infinity and denormal there is."""
    size = int(np.prod(shape)) * 8
    return st.binary(min_size=size, max_size=size).map(
        lambda raw: np.frombuffer(raw, dtype="<f8").reshape(shape).copy()
    )


NS = st.integers(-(2**63), 2**63 - 1)
FLOATS = st.floats(width=64)
STAMPS = st.builds(Stamp, NS, NS, NS, st.none() | NS)
STATUS = st.sampled_from(list(Status))
STATUS4, STATUS8 = (st.lists(STATUS, min_size=n, max_size=n).map(tuple) for n in (4, 8))
BYTES8 = st.lists(st.integers(0, 255), min_size=8, max_size=8).map(tuple)
NAMED_FLOATS = st.dictionaries(st.text(max_size=8), FLOATS, max_size=4)


def few(strategy: st.SearchStrategy[object]) -> st.SearchStrategy[tuple[object, ...]]:
    return st.lists(strategy, max_size=2).map(tuple)


POSES = st.builds(PoseMeasurement, STAMPS, st.text(max_size=9), doubles(3), st.integers(0, 3), st.booleans())
INPUTS = st.builds(
    Inputs,
    cycle=NS,
    t_ns=NS,
    servos=few(st.builds(ServoSample, STAMPS, doubles(8), doubles(8), doubles(8), STATUS8, BYTES8)),
    health=few(st.builds(ServoHealth, STAMPS, doubles(8), doubles(8), STATUS8)),
    encoders=few(st.builds(EncoderSample, STAMPS, doubles(4), STATUS4, few(st.integers(0, 2**18)))),
    imu=few(
        st.builds(
            ImuSample,
            STAMPS,
            doubles(4),
            doubles(3),
            doubles(3),
            doubles(3),
            st.tuples(*[st.integers(0, 3)] * 4),
            STATUS,
        )
    ),
    tracker=few(
        st.builds(
            TrackerSample, STAMPS, doubles(3), doubles(4), doubles(3), doubles(3), st.integers(0, 3), STATUS
        )
    ),
    mocap=few(st.builds(MocapSample, STAMPS, doubles(3), doubles(4), st.booleans(), FLOATS, FLOATS, STATUS)),
    adhesion=few(st.builds(AdhesionSample, STAMPS, *[FLOATS] * 7, STATUS, st.text(max_size=9))),
    thrust=few(st.builds(ThrustSample, STAMPS, FLOATS, FLOATS, STATUS)),
    load_cells=few(
        st.builds(LoadCellSample, STAMPS, doubles(2), st.tuples(STATUS, STATUS), few(st.integers(0, 2**18)))
    ),
)
MEASUREMENTS = st.builds(
    Measurements,
    cycle=NS,
    t_ns=NS,
    wheels=few(st.builds(WheelMeasurement, STAMPS, doubles(4), doubles(4), doubles(4), few(st.booleans()))),
    gyro=few(st.builds(GyroMeasurement, STAMPS, FLOATS, FLOATS, doubles(2))),
    tracker=few(POSES),
    mocap=few(POSES),
)
TRUTHS = st.dictionaries(
    st.text(max_size=6),
    st.recursive(
        st.none() | st.booleans() | NS | FLOATS | st.text(max_size=6) | doubles(3),
        lambda inner: few(inner) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
        max_leaves=4,
    ),
    max_size=3,
)
CYCLE_RECORDS = st.builds(
    CycleRecord,
    cycle=NS,
    deadline_ns=NS,
    start_ns=NS,
    inputs=INPUTS,
    measurements=MEASUREMENTS,
    state=st.builds(RobotState, NS, doubles(3), doubles(3), doubles(6, 6), NAMED_FLOATS),
    reference=st.none() | st.builds(Reference, FLOATS, doubles(3), doubles(3), doubles(3), st.booleans()),
    setpoint=st.builds(WheelSetpoint, doubles(4), doubles(4)),
    command=st.builds(ServoSetpoint, doubles(4), doubles(4)),
    events=few(st.builds(Event, NS, *[st.text(max_size=8)] * 3)),
    timing_ns=st.dictionaries(st.text(max_size=6), NS, max_size=3),
    truth=st.none() | TRUTHS,
)
