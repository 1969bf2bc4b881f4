"""Servo models read from the TOML files of this folder, one file per family, when first asked for."""

import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hil.config.servo_models.control_table_entry import Register
from hil.config.servo_models.model import Motor, Performance, ServoModel
from hil.core.errors import UsageError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DEFAULT_MODEL = 1010
"""Model that is emulated where the bench file names none: XH430-W210, as of the public recordings."""

_FOLDER = Path(__file__).parent


@cache
def servo_models() -> Mapping[int, ServoModel]:
    """Every model that has a control table, by model number."""
    models = [model for family in _families() for model in _models(family)]
    return MappingProxyType({model.number: model for model in sorted(models, key=lambda m: m.number)})


def servo_model(number: int) -> ServoModel:
    """The model with a model number.

    Raises:
        UsageError: there is no control table for it.
    """
    model = servo_models().get(number)
    if model is None:
        raise UsageError(
            f"there is no control table for servo model {model_text(number)}",
            expected=models_text(),
            remedy="add it to hil/config/servo_models, or use a model that has one",
        )
    return model


@cache
def shared_register(name: str) -> Register:
    """A register that all models have at the same address: it can be read before the model is known.

    Raises:
        LookupError: the models differ.
    """
    found = [model.table[name] for model in servo_models().values()]
    if len({(r.address, r.size, r.signed) for r in found}) != 1:
        raise LookupError(f"the models do not agree on {name}")
    return found[0]


def model_text(number: int) -> str:
    """Number and name of a model, also of one without a table."""
    name = _names().get(number)
    return f"{number} ({name})" if name else str(number)


def models_text() -> str:
    """The models that have a table, in words."""
    *others, last = (model_text(number) for number in servo_models())
    return f"{', '.join(others)} or {last}"


@cache
def _families() -> tuple[dict[str, Any], ...]:
    return tuple(tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(_FOLDER.glob("*.toml")))


@cache
def _names() -> Mapping[int, str]:
    named = {int(number): name for family in _families() for number, name in family["no_table"].items()}
    return {**named, **{number: model.name for number, model in servo_models().items()}}


def _models(family: Mapping[str, Any]) -> Iterator[ServoModel]:
    for entry in family["models"]:
        table = {register.name: register for register in _registers(family, entry)}
        yield ServoModel(
            number=entry["number"],
            name=entry["name"],
            table=MappingProxyType(table),
            table_size=family["size"],
            counts_per_turn=family["counts_per_turn"],
            zero_counts=family["zero_counts"],
            fast_read_firmware=family["fast_read_firmware"],
            gear_ratio=entry["gear_ratio"],
            a_per_count=entry["a_per_count"],
            supply_v=tuple(entry["supply_v"]),
            recommended_v=entry["recommended_v"],
            performance=tuple(Performance(**row) for row in entry["performance"]),
            motor=Motor(**entry["motor"]),
        )


def _registers(family: Mapping[str, Any], model: Mapping[str, Any]) -> Iterator[Register]:
    """The control table of one model: the family's entries with what is the model's own."""
    scales = {**family["scales"], "A": model["a_per_count"]}
    own = {"model_number": {"default": model["number"]}, **model["registers"]}
    entries = {entry["name"]: {**entry, **own.get(entry["name"], {})} for entry in family["registers"]}
    for entry in entries.values():
        given = {k: v for k, v in entry.items() if k not in ("access", "area", "values")}
        given.setdefault("scale", scales.get(entry.get("unit"), 1.0))
        if "limit" in entry:
            given.setdefault("default", entries[entry["limit"]]["default"])
        yield Register(
            writable=entry["access"] == "rw",
            eeprom=entry["area"] == "eeprom",
            values=tuple(entry.get("values", ())),
            **given,
        )
    for block in family["indirect"]:
        yield from _indirect(block, family["indirect_low"], family["indirect_high"])


def _indirect(block: Mapping[str, int], low: int, high: int) -> Iterator[Register]:
    for k in range(block["count"]):
        number, data = block["first"] + k, block["data"] + k
        address = block["address"] + 2 * k
        yield Register(
            f"indirect_address_{number}", address, 2, True, False, default=data, low=low, high=high
        )
        yield Register(f"indirect_data_{number}", data, 1, True, False, low=0, high=255)
