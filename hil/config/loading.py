"""Finds, reads, overrides and checks a `bench.toml`.

Strict: unknown keys are errors, and every problem is reported at once with its dotted path.
"""

import copy
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import date
from itertools import islice
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from hil.config.bench import BenchConfig, bench_model
from hil.config.robot_record.overlay import apply_record, check_record
from hil.config.several_devices import devices_in, further_in, resolve_device, spread
from hil.config.shipped_profiles import profile_names, profile_text
from hil.config.table_consistency import contradictions
from hil.core.errors import ConfigError, HilError, did_you_mean, did_you_mean_file
from hil.core.registry import kinds
from hil.support.atomic_files import check_name
from hil.support.file_reading import get_dotted, put_dotted, read_toml, toml_tables

_PATHS = ("calibration", "emulation.mjcf", "emulation.replay", "monitor.mesh", "record.folder")
_ADD_ONE = (
    "add the table of a device, as [imu] (docs/bench-file.md); hil discover prints the tables of those that "
    "answer"
)
_MOST_LOOKED_AT = 200
"""Files of a folder in which a bench file is looked for."""
_SCHEMA: int = get_args(BenchConfig.model_fields["schema_version"].annotation)[0]
_NOISE_OF = {"servos": ("process", "wheels", "wall"), "imu": ("gyro",), "tracker": ("tracker",)}
"""Tables of `estimator` that speak of a device."""


def _bench_files(folder: Path) -> list[str]:
    """Bench files of a folder, as suggestions for a wrong name."""
    with suppress(OSError):
        return sorted(
            str(found) for found in islice(folder.glob("*.toml"), _MOST_LOOKED_AT) if _is_bench(found)
        )
    return []


def _is_bench(path: Path) -> bool:
    """Whether a TOML file has the keys of every bench file."""
    with suppress(HilError):
        return {"schema", "name"} <= read_toml(path).keys()
    return False


def find_bench(source: str | Path) -> tuple[dict[str, Any], str]:
    """Tables and printable origin of a bench file: a path, or the name of a shipped profile.

    Each device has a table of its own, also where the file has several of a kind
    (`hil.config.several_devices`).

    Raises:
        ConfigError: it is neither, cannot be read, or names of several devices of a kind are wrong.
        UsageError: no file can have that name.
    """
    tree, origin = _found(source)
    return spread(tree, origin), origin


def _found(source: str | Path) -> tuple[dict[str, Any], str]:
    path = Path(source)
    check_name(path, "bench")
    if path.suffix == ".toml" or path.exists():
        there = () if path.exists() else _bench_files(path.parent)
        near = did_you_mean_file(source, there)
        return read_toml(path, remedy=near or "give a bench.toml or a profile name"), str(path)
    if str(source) in profile_names():
        origin = f"profile {source}"
        return toml_tables(profile_text(str(source)), origin), origin
    raise ConfigError(
        f"bench {str(source)!r} is neither a file nor a shipped profile",
        expected="a path to a .toml file or one of " + ", ".join(profile_names()),
        remedy=did_you_mean_file(source, _bench_files(path.parent))
        or did_you_mean(str(source), profile_names()),
    )


class NoSuchDevice(ConfigError):
    """The bench has no device of the name that is to be emulated; `present` are its devices."""

    def __init__(self, device: str, present: Sequence[str]) -> None:
        self.device, self.present = device, tuple(present)
        if not present:
            super().__init__(f"--emulate {device}: the bench has no device at all", remedy=_ADD_ONE)
            return
        super().__init__(
            f"--emulate {device}: the bench has no such device",
            expected="all or some of " + ", ".join(present),
            remedy=did_you_mean(device, present),
        )


def must_have_a_device(config: BenchConfig, source: str, otherwise: str) -> None:
    """Refuse a bench without any device.

    Args:
        config: configuration of the bench.
        source: file or profile, as it was named.
        otherwise: consequence of a missing device, in words.

    Raises:
        ConfigError: it has none.
    """
    if not config.devices():
        raise ConfigError(f"no device in {source}: {otherwise}", remedy=_ADD_ONE)


def load_bench(
    source: str | Path | BenchConfig = "emulated",
    *,
    emulate: str | tuple[str, ...] | None = None,
    overrides: Mapping[str, object] | None = None,
    today: date | None = None,
    seed: int | None = None,
) -> BenchConfig:
    """Read and check a bench configuration, with the values of the robot's record that it names.

    Args:
        source: path, profile name, or a model that is already built.
        emulate: `all` or device names whose backend is switched to emulated.
        overrides: dotted key -> value, applied before validation. With another model of a device
            (`imu.model`) the keys of its table that only the model of the source has are left out.
        today: date for the validity of the record's parts, today by default.
        seed: seed of the emulated world; identifies its robot in the record.

    Raises:
        ConfigError: listing every problem with its dotted path, or a record that cannot be used.
    """
    record = None
    if isinstance(source, BenchConfig):
        tree, origin = source.model_dump(by_alias=True, exclude_unset=True), source.name
    else:
        tree, origin = find_bench(source)
        if origin == str(source):
            _anchor(tree, Path(source).parent)
        else:
            _forget_noise(tree, overrides or {})
    _change_models(tree, overrides or {})
    if not isinstance(source, BenchConfig):
        record = apply_record(tree, overrides or {}, today or date.today())
    for dotted, value in (overrides or {}).items():
        put_dotted(tree, dotted, value, "override")
    _anchor(tree, Path.cwd())
    for name in _to_emulate(tree, emulate):
        tree[name]["backend"] = "emulated"
    config = validate(tree, origin, tuple(overrides or {}))
    check_record(record, config, seed)
    return config


def _change_models(tree: dict[str, Any], overrides: Mapping[str, object]) -> None:
    """Remove keys that the new model lacks from tables whose model an override changes."""
    for kind in (kinds()[name] for name in devices_in(tree)):
        table, name = tree[kind.name], overrides.get(f"{kind.name}.model")
        model = next((m for m in kind.models if m.name == name), None)
        if model is None:
            continue
        if table.get("model", kind.models[0].name) != name:
            tree[kind.name] = {key: v for key, v in table.items() if key in model.config.model_fields}


def _forget_noise(tree: dict[str, Any], overrides: Mapping[str, object]) -> None:
    """Remove a profile's noise of devices that are to be real; with a preset, its whole `estimator`."""
    if overrides.get("estimator.preset", "recommended") != "recommended":
        tree.pop("estimator", None)
    for name, tables in _NOISE_OF.items():
        if overrides.get(f"{name}.backend", "emulated") != "emulated":
            for table in tables:
                tree.get("estimator", {}).pop(table, None)


def path_keys(names: Iterable[str]) -> tuple[str, ...]:
    """Dotted keys of a bench file that name a file or a folder.

    Args:
        names: names of the bench's devices; other names are ignored.
    """
    models = (m for name in names if name in kinds() for m in kinds()[name].models)
    of_devices = (f"{m.kind}.{path}" for m in models for path in getattr(m.config, "PATHS", ()))
    return tuple(dict.fromkeys((*_PATHS, *of_devices)))


def bench_files(tree: Mapping[str, Any], folder: Path) -> dict[str, Path]:
    """Files and folders that a bench file names, by dotted key; relative ones start at `folder`.

    Args:
        tree: parsed bench file, as `find_bench` gives it.
        folder: folder in which relative paths start.
    """
    found = {}
    for dotted in path_keys(tree):
        value = get_dotted(tree, dotted)
        if isinstance(value, str):
            found[dotted] = folder / value
    return found


def _anchor(tree: dict[str, Any], folder: Path) -> None:
    """Make relative paths absolute: those of a bench file start at its folder, others at the current one."""
    for dotted, path in bench_files(tree, folder).items():
        check_name(path, dotted)
        put_dotted(tree, dotted, str(path), "path")


def _to_emulate(tree: Mapping[str, Any], emulate: str | tuple[str, ...] | None) -> tuple[str, ...]:
    if emulate is None:
        return ()
    said = tuple(emulate.split(",")) if isinstance(emulate, str) else emulate
    present = devices_in(tree)
    if said == ("all",):
        return present
    labels = {name: tree[name].get("name") for name in present}
    names = tuple(resolve_device(word, labels) for word in said)
    for name in names:
        if name not in present:
            raise NoSuchDevice(name, present)
    return names


def validate(tree: Mapping[str, Any], origin: str, overrides: Sequence[str] = ()) -> BenchConfig:
    """Model of a parsed file; raises `ConfigError` with all problems, and names `overrides` among them."""
    problems: list[str] = []
    config: BenchConfig | None
    try:
        tree = spread(tree, origin)
        config = bench_model(further_in(tree)).model_validate(tree)
    except ValidationError as error:
        problems += explained(error)
        config = _what_is_right(tree, [_place(item["loc"]) for item in error.errors()])
    if config is not None:
        problems += [f"{path}: {text}" for path, text in contradictions(config)]
        if not problems:
            return config
    reported = [problem.partition(":")[0] for problem in problems]
    set_over_it = [d for d in overrides if any(path == d or path.startswith(f"{d}.") for path in reported)]
    beside = f" with {', '.join(f'bench.{dotted}' for dotted in set_over_it)}" if set_over_it else ""
    raise ConfigError(f"{origin}{beside}: {len(problems)} problem(s)", problems=tuple(problems))


def _what_is_right(tree: Mapping[str, Any], wrong: list[tuple[int | str, ...]]) -> BenchConfig | None:
    """The configuration without its wrong values, to check the others; None if it is still invalid."""
    rest = copy.deepcopy(dict(tree))
    for *tables, key in wrong:
        table: Any = rest
        for name in tables:
            inner = table.get(name) if isinstance(table, dict) else None
            if not isinstance(inner, dict):
                key = name
                break
            table = inner
        if isinstance(table, dict):
            table.pop(key, None)
    try:
        return bench_model(further_in(rest)).model_validate(rest)
    except ValidationError:
        return None


def explained(error: ValidationError) -> list[str]:
    """Every problem of an error: its dotted path, and what is wrong there."""
    return [
        f"{'.'.join(str(part) for part in _place(item['loc'])) or 'file'}: {_reason(item)}"
        for item in error.errors()
    ]


def _place(loc: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Keys of the path to a problem, without the model name that pydantic inserts."""
    kind = kinds().get(str(loc[0])) if loc else None
    if kind is None or len(kind.models) == 1 or len(loc) == 1:
        return loc
    return (loc[0], *loc[2:]) if loc[1] in [m.name for m in kind.models] else loc


def _keys(loc: Sequence[int | str]) -> tuple[str, ...]:
    """Names of the keys in a table of the file, by pydantic's path; a model may follow the kind there."""
    models: list[Any] = [bench_model()]
    tables = list(_place(tuple(loc)))
    if len(tables) < len(loc):
        models, tables = [kinds()[str(loc[0])].model(str(loc[1])).config], tables[1:]
    elif tables and str(tables[0]) in kinds():
        models, tables = [m.config for m in kinds()[str(tables[0])].models], tables[1:]
    for name in tables:
        annotations = [m.model_fields[name].annotation for m in models if name in m.model_fields]
        models = [m for annotation in annotations for m in _models_in(annotation)]
    return tuple(field.alias or name for m in models for name, field in m.model_fields.items())


def _models_in(annotation: Any) -> list[Any]:
    """Pydantic models within a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models_in(inner)]


def _reason(item: Any) -> str:
    tables = _place(item["loc"])
    if item["type"] == "extra_forbidden":
        *above, key = tables
        known = ", ".join(kinds())
        keys = _keys(item["loc"][:-1])
        near = did_you_mean(str(key), keys)
        if {"interface", "options"} <= set(keys) and not near:
            near = f"an option of the python-can interface belongs to [{'.'.join(map(str, above))}.options]"
        table = above in ([], ["emulation"]) and isinstance(item["input"], Mapping)
        device = f"no device or table of that name (devices: {known}); install the package that adds it, or "
        return f"unknown key; {near or (device if table else '') + 'remove it or check the spelling'}"
    if item["type"] == "union_tag_invalid":
        names = [m.name for m in kinds()[str(tables[0])].models]
        tag = item["ctx"]["tag"]
        return f"model {tag!r} is unknown; expected {' or '.join(names)}{_also(did_you_mean(tag, names))}"
    if tables == ("schema",) and item["type"] == "literal_error":
        return _reason_of_schema(item["input"])
    if item["type"] == "missing":
        return _reason_of_missing(tables[-1] if tables else "")
    if item["type"] == "tuple_type":
        return f"must be a list{_as_a_list(item['input'])} (found {item['input']!r})"
    if item["type"] == "too_long":
        most, count = item["ctx"]["max_length"], item["ctx"]["actual_length"]
        return f"the list is too long, {count} values where {most} are expected (found {item['input']!r})"
    if item["type"] in ("model_type", "model_attributes_type"):
        return f"expected a table (found {item['input']!r})"
    return f"{item['msg']} (found {item['input']!r})"


def _reason_of_missing(key: int | str) -> str:
    """Problem of a key that is missing, or of a list without the element of an index."""
    return (
        f"missing: the list is too short, it has no number {key + 1}" if isinstance(key, int) else "missing"
    )


def _as_a_list(value: object) -> str:
    """How a single number or text is written as a list of TOML; empty for other values."""
    if isinstance(value, str):
        return f": [{json.dumps(value)}]"
    return f": [{json.dumps(value)}, ...]" if isinstance(value, (bool, int, float)) else ""


def _reason_of_schema(found: object) -> str:
    """Problem and remedy for a bench file whose `schema` is wrong, or is of another type."""
    if str(found) == str(_SCHEMA):
        return f"write it without quotes: schema = {_SCHEMA} (found {found!r})"
    newer = isinstance(found, int) and found > _SCHEMA
    do = f"use {'a newer' if newer else 'the'} version of the program that reads it"
    return (
        f"the file is of another version of this program, which reads schema {_SCHEMA} (found {found!r}); "
        f"{do}, or write schema = {_SCHEMA} and correct the keys that are then named (docs/bench-file.md)"
    )


def _also(hint: str) -> str:
    return f"; {hint}" if hint else ""
