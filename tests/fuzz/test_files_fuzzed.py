"""Whatever is in a file, its reader gives what it holds or an error of ours."""

import warnings

import numpy as np
import pytest
from cases import Finding, found_before, how_many
from files import files
from mutating import spoilt

NAMES = [
    "bench file",
    "fault timeline",
    "topics",
    "waypoints",
    "answers",
    "journal",
    "commissioning",
    "offsets",
    "record",
    "calibration",
    "public data set",
    "data set",
    "result",
    "run page",
    "recording",
]
SLOW = {"run page": 10, "recording": 40, "bench file": 40}
named = pytest.mark.parametrize("name", NAMES)


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    return {reader.name: reader for reader in files(tmp_path_factory.mktemp("sound"))}


def fuzzed(reader, cases):
    rng, sound = np.random.default_rng(13), reader.path.read_bytes()
    with Finding(reader.name) as finding, warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(cases):
            data = spoilt(rng, [sound])
            finding.about(data)
            reader(data)
        reader.path.write_bytes(sound)


def test_every_reader_is_named(readers):
    assert set(readers) == set(NAMES)


@named
def test_a_sound_file_is_read(readers, name):
    readers[name].read(readers[name].path)


@named
def test_reader_takes_any_file(readers, name):
    for data in found_before(name):
        readers[name](data)
    fuzzed(readers[name], SLOW.get(name, 60))


@pytest.mark.long
@named
def test_reader_takes_a_hundred_thousand(readers, name):
    fuzzed(readers[name], how_many(100_000))
