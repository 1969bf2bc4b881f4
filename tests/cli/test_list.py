"""`hil list` names what the other commands accept."""

import json

import pytest

from hil.bench import supported_faults
from hil.cli import declared, main
from hil.config.loading import load_bench
from hil.core.registry import kinds
from hil.faults.fault import parse_fault
from hil.procedure.procedure_lookup import load_procedure


@pytest.fixture
def listed(capsys):
    def of(*words):
        assert main(["list", *words, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return of


def test_every_listed_procedure_and_profile_can_be_used(listed):
    found = listed()
    for name, summary in found["procedures"].items():
        assert load_procedure(name).name == name
        assert summary
    for name, summary in found["profiles"].items():
        assert load_bench(name).name
        assert len(summary) > 10


def test_every_listed_estimator_runs_a_bench(listed):
    for name, what in listed("estimators")["estimators"].items():
        assert load_bench("emulated", overrides={"estimator.kind": name}).estimator.kind == name
        assert what


def test_devices_are_those_of_the_registry(listed):
    assert listed("devices")["devices"] == {
        k.name: {m.name: m.title for m in k.models} for k in kinds().values()
    }


def test_summaries_are_those_of_the_procedures(listed):
    listed = listed("procedures")["procedures"]
    assert listed == {name: load_procedure(name).summary for name in listed}


def test_devices_of_an_installed_package_are_listed_too(listed, monkeypatch):
    monkeypatch.setattr(declared, "entry_points", lambda group: ["a device package"])
    assert declared.devices()["servos"].models[0].package == "hil"
    assert [*declared.devices()] == [*kinds()]


def test_faults_are_those_that_the_emulated_bench_declares(listed):
    """If not: run docs/make_fault_reference.py."""
    found = supported_faults(load_bench("emulated", emulate="all"))
    assert listed("faults")["faults"] == {n: {k: [*o] for k, o in f.items()} for n, f in found.items()}


def test_faults_are_those_of_the_bench_that_is_named(listed):
    found = listed("faults", "--bench", "sensors")["faults"]
    assert {"plant", "encoders", "imu"} <= set(found)
    assert not [name for name in found if name.startswith("servo")]
    assert parse_fault("imu:stuck@1").kind in found["imu"]
    assert "probability" in found["imu"]["drop"]


def test_estimators_say_how_one_of_ones_own_is_named(capsys):
    assert main(["list", "estimators"]) == 0
    said = capsys.readouterr().out
    assert "FILE.py:NAME" in said
    assert "function" in said
