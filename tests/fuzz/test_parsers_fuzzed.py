"""Whatever bytes a parser gets, it says so in the way that it promises."""

import numpy as np
import pytest
from cases import Finding, how_many
from mutating import spoilt
from parsers import parsers

PARSERS = parsers()
named = pytest.mark.parametrize("parser", PARSERS, ids=lambda p: p.name.replace(" ", "-"))


def fuzzed(parser, cases):
    rng = np.random.default_rng(11)
    with Finding(parser.name) as finding:
        for _ in range(cases):
            data = spoilt(rng, parser.seeds, parser.seal)
            finding.about(data)
            parser(data)


@named
def test_sound_input_is_taken(parser):
    assert parser.seeds
    for data in parser.seeds:
        parser(data)


@named
def test_parser_takes_any_bytes(parser):
    fuzzed(parser, 150)


@pytest.mark.long
@named
def test_parser_takes_a_million(parser):
    fuzzed(parser, how_many(1_000_000))
