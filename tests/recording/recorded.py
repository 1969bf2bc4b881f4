"""Recordings of an emulated robot, as our own writer makes them and as `rosbags` reads them."""

import dataclasses

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hil.bench.pipelines import BenchModel
from hil.config.loading import load_bench
from hil.recording.mcap_writer import McapRecorder
from hil.robot.kinematics import WheelGeometry

STORE = get_typestore(Stores.ROS2_HUMBLE)
HEADER = BenchModel(load_bench("emulated"), geometry=WheelGeometry.nominal()).header()


def recorded(path, records, header, note=()):
    """A file of these records, and of a note behind them."""
    recorder = McapRecorder(path, header, lossless=True)
    for each in records:
        recorder.write(each)
    if note:
        recorder.note(*note)
    recorder.close()
    assert recorder.failure == ""
    return path


def messages(path):
    """(topic, log time, message) as `rosbags` reads them."""
    with AnyReader([path], default_typestore=STORE) as bag:
        for connection, log_ns, raw in bag.messages():
            yield connection.topic, log_ns, bag.deserialize(raw, connection.msgtype)


def of_numbers(message):
    """All numbers in a message, in no certain order."""
    if isinstance(message, (bool, str, bytes)):
        return []
    if isinstance(message, (int, float, np.number)):
        return [float(message)]
    if isinstance(message, (list, tuple, np.ndarray)):
        return [number for item in message for number in of_numbers(item)]
    return [
        number for field in dataclasses.fields(message) for number in of_numbers(getattr(message, field.name))
    ]
