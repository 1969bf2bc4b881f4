"""Whatever arrives, an emulated chip goes on and a driver gives samples or an error of ours."""

import warnings

import numpy as np
import pytest
from cases import Finding, how_many
from emulations import MODELS, NO_BYTES, spoil_answers, spoil_requests
from sealing import SEALS

AT_THE_WIRE = [m for m in MODELS if m.name not in NO_BYTES]
named = pytest.mark.parametrize("model", AT_THE_WIRE, ids=lambda m: f"{m.kind}-{m.name}")


def fuzzed(feed, model, cases):
    finding = Finding(f"{feed.__name__}-{model.kind}-{model.name}")
    with finding, warnings.catch_warnings():
        warnings.simplefilter("error")
        for data in feed(model, np.random.default_rng(7), cases, SEALS.get(model.name)):
            finding.about(data)


@named
def test_chip_takes_any_request(model):
    fuzzed(spoil_requests, model, 60)


@named
def test_driver_takes_any_answer(model):
    fuzzed(spoil_answers, model, 200)


@pytest.mark.long
@named
def test_chip_takes_a_million_requests(model):
    fuzzed(spoil_requests, model, how_many(1_000_000))


@pytest.mark.long
@named
def test_driver_takes_a_million_answers(model):
    fuzzed(spoil_answers, model, how_many(1_000_000))
