"""What cannot work is refused by name, with exit code 2, before a bench is opened."""

import pytest
from procedure_runs import options_of, watched

from hil.core.errors import HilError
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import run_procedure
from hil.procedure.shipped import shipped_names


def refused(name, folder, *, parameters=None, **source):
    used = watched(name, **source)
    with pytest.raises(HilError) as caught:
        run_procedure(load_procedure(name), used, options_of(folder, parameters))
    assert caught.value.exit_code == 2
    assert not used.benches
    return str(caught.value)


@pytest.mark.parametrize("name", shipped_names())
def test_an_unknown_parameter_and_a_device_that_the_bench_lacks_are_named(tmp_path, name):
    assert "no_such_thing" in refused(name, tmp_path / "run", parameters={"no_such_thing": "1"})
    needs = load_procedure(name).needs
    assert "servos" in needs
    for device in needs:
        assert device in refused(name, tmp_path / "run", overrides={device: None})
    assert not (tmp_path / "run").exists()


def test_a_missing_calibration_is_named(tmp_path):
    reported = refused("latency", tmp_path / "run", calibration=tmp_path / "gone.toml")
    assert "gone.toml" in reported
