"""Reads recorded configurations as they were, also values that would be refused today."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from hil.config.bench import BenchConfig, bench_model
from hil.config.field_types import RECORDED
from hil.config.loading import explained
from hil.config.several_devices import further_in
from hil.core.device import DeviceKind, DeviceModel
from hil.core.errors import ConfigError
from hil.core.registry import kinds


def recorded_bench(
    tree: Mapping[str, Any], origin: str, packages: Mapping[str, Any] | None = None
) -> BenchConfig:
    """The configuration that a recording carries.

    Bounds and contradictions are not checked: they matter before a run, and this run is over.

    Args:
        tree: parsed configuration in its header.
        origin: name of the recording, for errors.
        packages: packages that the recording was made with, by `KIND` or `KIND.MODEL`.

    Raises:
        ConfigError: listing every problem with its dotted path.
    """
    try:
        model = bench_model(further_in(tree))
        return model.model_validate(_without_absent(dict(tree), model), context=RECORDED)
    except ValidationError as error:
        problems = explained(error)
    other = _other_versions(packages or {})
    if other:
        problems.append(f"perhaps because of other versions: {other}")
    raise ConfigError(
        f"{origin}: {len(problems)} problem(s)",
        problems=tuple(problems),
        remedy="install the recorded versions, or give today's bench file with --bench" if other else "",
    )


def _other_versions(packages: Mapping[str, Any]) -> str:
    """Versions that a recording was made with, and those installed instead, in words."""
    found: dict[str, None] = {}
    for name, recorded in packages.items():
        kind, _, model = name.partition(".")
        here = kinds().get(kind)
        parts: Iterable[DeviceKind | DeviceModel] = ()
        if here is not None:
            parts = [m for m in here.models if m.name == model] if model else [here]
        for part in parts:
            if part.package != recorded:
                found[f"recorded with {recorded}, installed is {part.package}"] = None
    return "; ".join(found)


def _without_absent(tree: dict[str, Any], model: type[BenchConfig]) -> dict[str, Any]:
    """A configuration without the kinds of devices that the bench lacked and that are unknown here.

    Their package was installed then, and is not now: no reason to refuse the recording.
    """
    emulation = tree.get("emulation")
    if isinstance(emulation, Mapping):
        said = {key: value for key, value in emulation.items() if key in kinds() or value != {}}
        tree = {**tree, "emulation": said}
    return {key: value for key, value in tree.items() if key in model.model_fields or value is not None}


def changed_since(tree: object, config: BenchConfig) -> list[str]:
    """Dotted keys in which a configuration differs from one that was recorded.

    Args:
        tree: configuration as it was recorded; one that cannot be read differs as a whole, with an empty key.
        config: configuration of today.
    """
    if not isinstance(tree, Mapping):
        return [""]
    try:
        then = recorded_bench(tree, "the recorded configuration").model_dump(mode="json", by_alias=True)
    except ConfigError:
        return [""]
    return list(_different(then, config.model_dump(mode="json", by_alias=True), ""))


def _different(then: Any, now: Any, path: str) -> Iterator[str]:
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys((*then, *now)):
            yield from _different(then.get(key), now.get(key), f"{path}.{key}".lstrip("."))
    elif then != now:
        yield path
