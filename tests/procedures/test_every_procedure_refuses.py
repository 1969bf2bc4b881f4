"""What cannot work is refused by name, with exit code 2, before a bench is opened."""

import json

import pytest
from procedure_runs import AbsentOperator, watched

from hil.core.clock import MonotonicClock
from hil.core.errors import HilError
from hil.procedure.procedure_lookup import load_procedure, shipped_names
from hil.procedure.runner import RunOptions, run_procedure

NAMES = shipped_names()


def refused(name, folder, *, parameters=None, resume=False, **source):
    used = watched(name, **source)
    options = RunOptions(
        folder,
        MonotonicClock(),
        "2026-01-01T00:00:00",
        parameters or {},
        operator=AbsentOperator(),
        resume=resume,
    )
    with pytest.raises(HilError) as caught:
        run_procedure(load_procedure(name), used, options)
    assert caught.value.exit_code == 2
    assert not used.benches
    return str(caught.value)


@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_parameter_is_named(tmp_path, name):
    reported = refused(name, tmp_path / "run", parameters={"no_such_thing": "1"})
    assert "no_such_thing" in reported
    assert name in reported
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", NAMES)
def test_a_device_that_the_bench_lacks_is_named(tmp_path, name):
    needs = load_procedure(name).needs
    assert "servos" in needs
    for device in needs:
        reported = refused(name, tmp_path / device, overrides={device: None})
        assert device in reported
        assert not (tmp_path / device).exists()


def test_a_missing_calibration_is_named(tmp_path):
    reported = refused("latency", tmp_path / "run", calibration=tmp_path / "gone.toml")
    assert "gone.toml" in reported


@pytest.mark.parametrize("content", ["", "nonsense\n", '{"kind": "step"}\n', '{"kind": "run"}\n{"kind"\n'])
def test_a_broken_journal_is_named_and_left_as_it_is(tmp_path, content):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "journal.jsonl").write_text(content)
    reported = refused("latency", folder, resume=True)
    assert "journal.jsonl" in reported
    assert (folder / "journal.jsonl").read_text() == content
    assert not (folder / "result.json").exists()


def test_a_journal_of_another_run_is_refused(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "journal.jsonl").write_text(
        json.dumps({"kind": "run", "schema": 1, "procedure": "another", "parameters": {}}) + "\n"
    )
    assert "procedure" in refused("latency", folder, resume=True)
