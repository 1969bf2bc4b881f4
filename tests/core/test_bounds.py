"""Every number of every table of the bench file has bounds, refuses what lies beyond, and names them."""

import math
import typing

import pytest
from pydantic import BaseModel, ValidationError

from hil.cli import main
from hil.config.bench import bench_model
from hil.config.field_types import bounds_of
from hil.config.loading import explained
from hil.core.registry import kinds

WRONG = (0, -1, -1e-300, 1e-300, -1e12, 1e21, 10**400, math.inf, -math.inf, math.nan, True, False, "1")


def tables():
    """Every table as (path, model), and the tables in it."""
    found = [("", bench_model())]
    found += [(f"{m.kind} {m.name}", m.config) for kind in kinds().values() for m in kind.models]
    for path, model in found:
        for name, field in model.model_fields.items():
            inner = [a for a in (field.annotation, *typing.get_args(field.annotation)) if is_table(a)]
            if inner and not (path == "" and name in kinds()):
                found.append((f"{path}.{name}", inner[0]))
    return found


def is_table(annotation):
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


NUMBERS = [
    pytest.param(model, name, field, id=f"{path}.{field.alias or name}")
    for path, model in tables()
    for name, field in model.model_fields.items()
    if list(bounds_of(field.annotation, field.metadata))
]


def problems_of(model, name, value):
    try:
        model.model_validate({name: value})
    except ValidationError as error:
        return [text for text in explained(error) if text.startswith(name)]
    return []


@pytest.mark.parametrize(("model", "name", "field"), NUMBERS)
def test_a_number_has_bounds_and_names_them_where_it_is_refused(model, name, field):
    key = field.alias or name
    bounds = list(bounds_of(field.annotation, field.metadata))
    for _, bound in bounds:
        assert bound is not None, f"{key} has no bounds"
        assert -math.inf < bound.low < bound.high < math.inf
    if "dict" in str(field.annotation):
        return
    default = field.get_default(call_default_factory=True)
    if default is None and len(bounds) > 1:
        default = tuple(bound.low for _, bound in bounds)
    places = range(len(default)) if isinstance(default, tuple) else (None,)
    truth = "bool" in str(field.annotation) or "Switch" in str(field.annotation)
    text = "str" in str(field.annotation)
    for place in places:
        kind, bound = bounds[place or 0] if len(bounds) > (place or 0) else bounds[0]
        for value in (*WRONG, bound.low, bound.high):
            given = value if place is None else [*default[:place], value, *default[place + 1 :]]
            reported = problems_of(model, key, given)
            if (text and isinstance(value, str)) or (truth and isinstance(value, bool)):
                continue
            if bound.permits(value, whole=kind is int):
                assert not any(bound.range_text() in one for one in reported)
            else:
                assert any(bound.range_text() in one or "number" in one for one in reported), (
                    value,
                    reported,
                )


REFUSED = {
    'port = "\\u0000"': "imu.port",
    "reply_timeout_s = -1": "imu.reply_timeout_s",
    "prefetch = 1": "imu.prefetch",
    "baud = true": "imu.baud",
    'baud = "115200"': "imu.baud",
    "baud = 1e300": "imu.baud",
    "fail_after_s = inf": "imu.fail_after_s",
    "[encoders]\nrate_hz = 1e-300": "encoders.rate_hz",
    "[safety]\nservo_stale_s = true": "safety.servo_stale_s",
    "[control]\ngains = [0, 0, 0]": "control.gains.0",
    "[robot]\nwheel_x_m = 0": "robot.wheel_x_m",
    "[robot]\nwheel_x_m = [0, 0, 0, 0]": "robot",
    "[tracker]\nopen_timeout_s = -5": "tracker.open_timeout_s",
    "[estimator.gates]\nreanchor_after = 1e21": "estimator.gates.reanchor_after",
    '[encoders]\nchannel = "a\\u0000b"': "encoders.channel",
    "[encoders]\noptions = {port = 1e300}": "encoders.options.port",
    '[emulation]\nfaults = ["\\u0000"]': "emulation.faults",
    '[environment]\nsurface = "\\u001b"': "environment.surface",
}


@pytest.mark.parametrize(("text", "key"), REFUSED.items(), ids=REFUSED.values())
def test_a_command_ends_with_2_and_names_the_key(tmp_path, capsys, text, key):
    bench = tmp_path / "bench.toml"
    bench.write_text(f'schema = 1\nname = "x"\n[imu]\n{text}\n')
    assert main(["doctor", "--bench", str(bench)]) == 2
    assert f"  {key}: " in capsys.readouterr().err.replace("- ", "  ")
