"""Frozen dataclasses that are made quickly are as those that are not."""

import copy
import inspect
import pickle
from collections.abc import Mapping
from dataclasses import FrozenInstanceError, asdict, dataclass, field, fields, replace

import pytest

from hil.vocabulary import signals
from hil.vocabulary.records import quickly_made


@dataclass(frozen=True)
class Usual:
    first: int
    second: float = 2.0
    third: Mapping[str, int] = field(default_factory=dict)


@quickly_made
@dataclass(frozen=True)
class Quick:
    first: int
    second: float = 2.0
    third: Mapping[str, int] = field(default_factory=dict)


@pytest.mark.parametrize("given", [{"first": 1}, {"first": 1, "second": 3.0, "third": {"a": 1}}])
def test_fields_and_defaults_are_those_of_dataclasses(given):
    usual, quick = Usual(**given), Quick(**given)
    assert asdict(quick) == asdict(usual)
    assert repr(quick) == repr(usual).replace("Usual", "Quick")
    assert quick == Quick(**given) == copy.copy(quick) == pickle.loads(pickle.dumps(quick))
    assert replace(quick, first=5) == Quick(**{**given, "first": 5})
    assert Quick(1).third is not Quick(1).third


def test_arguments_are_those_of_dataclasses():
    usual, quick = (inspect.signature(kind).parameters for kind in (Usual, Quick))
    assert [(p.name, p.kind, p.annotation) for p in quick.values()] == [
        (p.name, p.kind, p.annotation) for p in usual.values()
    ]
    with pytest.raises(TypeError, match=r"Quick.__init__\(\) missing .* 'first'"):
        Quick()
    with pytest.raises(TypeError, match="fourth"):
        Quick(1, fourth=2)


def test_nobody_can_set_a_field():
    with pytest.raises(FrozenInstanceError):
        Quick(1).first = 2
    with pytest.raises(AssertionError):

        @quickly_made
        @dataclass(frozen=True)
        class Checked:
            first: int

            def __post_init__(self):
                assert self.first


def test_samples_know_each_of_their_fields():
    stamp = signals.Stamp(1, 2, seq=3)
    assert vars(stamp) == {f.name: getattr(stamp, f.name) for f in fields(stamp)}
    assert stamp.device_ns is None
