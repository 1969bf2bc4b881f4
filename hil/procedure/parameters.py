"""Converts `--set key=value` to typed parameters of a procedure; reports all problems at once."""

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, get_type_hints

from pydantic import BaseModel, TypeAdapter, ValidationError

from hil.config.bench import BenchConfig
from hil.core.errors import ConfigError, UsageError, did_you_mean
from hil.core.registry import kinds
from hil.core.third_party_errors import of_a_script
from hil.support.file_reading import json_value

BENCH_PREFIX = "bench."

_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
"""Cached pydantic adapter of a parameter class: it takes milliseconds to make."""


def split_settings(settings: Iterable[str]) -> tuple[dict[str, str], dict[str, object]]:
    """Split `key=value` texts into parameters and, for keys that start with `bench.`, bench overrides.

    Raises:
        UsageError: a text without `=`, or a key without a name (`bench.`).
    """
    parameters: dict[str, str] = {}
    bench: dict[str, object] = {}
    for text in settings:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise UsageError(f"--set {text!r} cannot be read", expected="key=value")
        key = key.strip()
        if key.startswith(BENCH_PREFIX):
            if not all(key.split(".")):
                raise UsageError(
                    f"--set {text!r} names no key of the bench file",
                    expected="bench.KEY=value",
                    remedy="write, for example, bench.loop.rate_hz=50",
                )
            bench[key.removeprefix(BENCH_PREFIX)] = _plain(value)
        else:
            parameters[key] = value
    return parameters, bench


def make_parameters(model: type[Any], values: Mapping[str, Any], owner: str) -> Any:
    """Return an instance of the parameter model.

    Args:
        model: dataclass or pydantic model.
        values: texts (converted by the field's type; sequences may be written `a,b`) or typed values.
        owner: name of the procedure, for error messages.

    Raises:
        ConfigError: lists all unknown keys and invalid values.
    """
    hints = field_types(model)
    problems = []
    typed: dict[str, Any] = {}
    for key, value in values.items():
        if key not in hints:
            known = f"known are {', '.join(hints)}" if hints else f"{owner} has no parameters"
            if key.partition(".")[0] in (*BenchConfig.model_fields, *kinds()):
                known = f"a key of the bench file is given as bench.{key}"
            problems.append(f"{key}: unknown parameter; {did_you_mean(key, hints) or known}")
            continue
        try:
            typed[key] = _convert(hints[key], value)
        except ValidationError as error:
            problems.append(f"{key}: {error.errors()[0]['msg']} (found {value!r})")
            continue
        if not _finite(typed[key]):
            problems.append(f"{key}: must be a finite number (found {value!r})")
    if not problems:
        with of_a_script(f"parameters of procedure {owner}"):
            try:
                return _adapter(model).validate_python(typed)
            except ValidationError as error:
                problems = [f"{'.'.join(map(str, e['loc'])) or 'all'}: {e['msg']}" for e in error.errors()]
    raise ConfigError(f"procedure {owner}: {len(problems)} wrong parameter(s)", problems=tuple(problems))


def field_types(model: type[Any]) -> dict[str, Any]:
    """Return names and types of a parameter model's fields."""
    if issubclass(model, BaseModel):
        return {name: field.annotation for name, field in model.model_fields.items()}
    hints = get_type_hints(model)
    return {f.name: hints[f.name] for f in dataclasses.fields(model)}


def check_model(model: object, owner: str) -> None:
    """Check that declared parameters are a dataclass or a pydantic model.

    Raises:
        UsageError: `model` is neither a dataclass nor a pydantic model.
    """
    if not isinstance(model, type) or not (issubclass(model, BaseModel) or dataclasses.is_dataclass(model)):
        shown = model.__name__ if isinstance(model, type) else f"a {type(model).__name__}"
        raise UsageError(
            f"procedure {owner}: parameters is {shown}",
            expected="a class: a dataclass, or a pydantic model, whose fields have defaults",
            remedy="write `class Parameters(BaseModel): length_m: float = 0.2` and parameters=Parameters",
        )


def as_dict(parameters: Any) -> dict[str, Any]:
    """Return parameters as JSON values."""
    found = _adapter(type(parameters)).dump_python(parameters, mode="json")
    return dict(found)


def _finite(value: Any) -> bool:
    """Whether all numbers in a value are finite."""
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, Mapping):
        return all(map(_finite, value.values()))
    return not isinstance(value, (list, tuple)) or all(map(_finite, value))


def _convert(kind: Any, value: Any) -> Any:
    adapter = TypeAdapter(kind)
    if not isinstance(value, str):
        return adapter.validate_python(value)
    attempts = [value, _plain(value), [part.strip() for part in value.split(",") if part.strip()]]
    for attempt in attempts[1:]:
        try:
            return adapter.validate_python(value)
        except ValidationError:
            value = attempt
    return adapter.validate_python(value)


def _plain(text: str) -> Any:
    try:
        return json_value(text)
    except ValueError:
        return text


@dataclasses.dataclass(frozen=True)
class Described:
    """Description of a parameter for the user.

    Attributes:
        name: its key.
        kind: JSON type of its value: `boolean`, `integer`, `number`, `string`, `array`.
        default: default value in the notation of `--set`.
        low, high: limits, if any; `low_open` if `low` itself is not allowed.
        choices: allowed values of the parameter, or of each list item; empty for any.
        help: description by its author; empty for none.
    """

    name: str
    kind: str
    default: str
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    choices: tuple[str, ...] = ()
    help: str = ""


def described(model: type[Any]) -> tuple[Described, ...]:
    """Describe the parameters of a model (dataclass or pydantic model), in its order."""
    names = field_types(model)
    properties = TypeAdapter(model).json_schema().get("properties", {})
    defaults = as_dict(model())
    return tuple(_described(name, properties.get(name, {}), defaults.get(name)) for name in names)


def _described(name: str, schema: Mapping[str, Any], default: Any) -> Described:
    one = next((s for s in schema.get("anyOf", ()) if s.get("type") != "null"), schema)
    value = one.get("items", one)
    choices = value.get("enum", (value["const"],) if "const" in value else ())
    open_low = one.get("exclusiveMinimum")
    return Described(
        name,
        str(one.get("type", "string")),
        written(default),
        one.get("minimum", open_low),
        one.get("maximum", one.get("exclusiveMaximum")),
        open_low is not None,
        tuple(map(str, choices)),
        str(schema.get("description", "")),
    )


def written(value: Any) -> str:
    """Return a value in the notation of `--set`."""
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, (list, tuple)) and all(isinstance(v, (str, int, float)) for v in value):
        return ",".join(map(written, value))
    return json.dumps(value)
