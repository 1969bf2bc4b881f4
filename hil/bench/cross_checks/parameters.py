"""The parameters of one bench, and what measurements have said about each of them so far."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from hil.bench.cross_checks.force import force_checks
from hil.bench.cross_checks.gravity import gravity_checks
from hil.bench.cross_checks.steering import steering_checks
from hil.config.assumed_parameters import Parameter, parameters_of
from hil.config.bench import BenchConfig
from hil.config.robot_record import Confirmation
from hil.config.robot_record.overlay import kept_confirmations
from hil.config.robot_record.parts import part_of
from hil.core.cross_check import CrossCheck, strongest
from hil.core.errors import ConfigError
from hil.core.registry import kinds
from hil.core.signals import Event
from hil.loop.checks.lifting_work import FITS_SHARE, WeightCheck

OF_NO_DEVICE = ("environment", "robot", "alignment")
"""Tables without a device that have parameters."""
_BY_REPORTS = ("adhesion", "adhesion_disagree", "thrust_disagree")
"""Reasons of stops in which reports of fan, propellers and load cells are compared."""
_KEY = re.compile(r"[a-z_]+\.[a-z_]+")
_LOOK_AT = re.compile(
    rf"look at ({_KEY.pattern}(?:(?:, then at the reported speed, and at |, | and ){_KEY.pattern})*)"
)
"""Keys to look at; devices in their place are no numbers of the bench file."""
RESTING = ("servos", "encoders", "imu", "tracker", "mocap", "adhesion", "load_cells")
"""Devices whose samples at rest say something about a parameter."""


def at_rest(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[CrossCheck]:
    """Everything that samples of a resting robot say about the bench file.

    Args:
        config: configuration of the bench.
        seen: samples by kind.
    """
    yield from gravity_checks(config, seen)
    yield from steering_checks(config, seen)
    for check in force_checks(config, seen):
        if check.state == "confirmed":  # what contradicts a force stops the robot, and is told by the doctor
            yield check


class Parameters:
    """What the bench takes for granted, and what its measurements say about it.

    Args:
        config: configuration of the bench.
    """

    def __init__(self, config: BenchConfig) -> None:
        self._config = config
        self._found: list[CrossCheck] = []
        self._moved: dict[str, CrossCheck] = {}

    def take(self, found: Iterable[CrossCheck]) -> list[CrossCheck]:
        """Add results; return the contradictions that are new."""
        before = set(self.contradicted())
        self._found = list(strongest([*self._found, *found]).values())
        return [check for key, check in self.contradicted().items() if key not in before]

    def moved(self, contradicting: Mapping[str, Event]) -> None:
        """Take what the events of runs have contradicted, by key."""
        for key, event in contradicting.items():
            value = self._value(key)
            says = _times(value, event.factor) if event.factor else math.nan
            self._moved[key] = CrossCheck(
                key, value, "contradicted", event.source, says, event.factor - 1.0, event.message
            )

    def stopped(self, reason: str, text: str) -> None:
        """Take the keys to which reports of fan and propellers that contradict each other point.

        Args:
            reason: reason of a stop.
            text: the stop in words, with its keys right after "look at".
        """
        if reason not in _BY_REPORTS:
            return
        for named in _LOOK_AT.findall(text):
            for key in _KEY.findall(named):
                if (value := self._value(key)) is not None:
                    self._moved[key] = CrossCheck(
                        key, value, "contradicted", "the stop of the robot", text=text
                    )

    def lifted(self, check: WeightCheck | None) -> None:
        """Take the work of the drives of a run, where it fits the weight."""
        if check is None or not abs(check.off_share) <= FITS_SHARE:
            return
        lifted, off = check.lifted, check.off_share
        to_push = lifted.weight_n / lifted.thrust_n if lifted.thrust_n else math.nan
        keys = lifted.keys if lifted.thrust_n else ()
        shown = [("robot.mass_kg", off, FITS_SHARE, keys)]
        shown += [(key, -off * to_push, FITS_SHARE * to_push, ("robot.mass_kg",)) for key in keys]
        for key, differs, within, given in shown:
            if (value := self._value(key)) is not None:
                by = "the work of the drives"
                self.take(
                    [CrossCheck(key, value, "confirmed", by, value, differs, within=within, given=given)]
                )

    def _value(self, key: str) -> Any:
        table, _, name = key.partition(".")
        return getattr(getattr(self._config, table, None), name, None)

    def contradicted(self) -> dict[str, CrossCheck]:
        """Contradictions at rest, by key."""
        return {check.key: check for check in self._found if check.state == "contradicted"}

    def partly(self, key: str) -> CrossCheck | None:
        """The confirmation of a parameter that leaves something beside; None without one."""
        partial = (check for check in self._found if check.state == "confirmed" and check.beside)
        return next((check for check in partial if check.key == key), None)

    def not_to_be_found(self) -> list[CrossCheck]:
        """Contradictions at rest that no procedure can resolve: whatever they find would be wrong.

        Where one of two keys is wrong, and a procedure finds one of them, that procedure resolves it.
        """
        found = self.contradicted()
        finds = [key for key in found if part_of(key)]
        return [
            check
            for key, check in found.items()
            if key.startswith("environment.") or not any(other in check.text for other in finds)
        ]

    def rows(self) -> list[CrossCheck]:
        """One result for each parameter of the bench file, and for what else was contradicted."""
        found = strongest([*self._found, *self._moved.values()])
        independent = {key for key, check in found.items() if check.state == "confirmed" and not check.given}
        kept = kept_confirmations(self._config)
        tables = {name: getattr(self._config, name) for name in OF_NO_DEVICE} | self._config.devices()
        rows = []
        for key, value, one in parameters_of(tables):
            check = found.pop(key, CrossCheck(key, value, "unconfirmed", self._awaited(one)))
            if check.state == "confirmed" and check.beside:
                by = f"{check.by}; {check.beside}: {self._awaited(one)}"
                check = check._replace(state="unconfirmed", by=by)
            elif check.state == "confirmed" and (rests := set(check.given) - independent):
                check = check._replace(state="unconfirmed", by=f"{check.by}, {_rests_on(sorted(rests))}")
            rows.append(_of_the_record(check, kept))
        return rows + [check for check in found.values() if check.state == "contradicted"]

    def _awaited(self, parameter: Parameter) -> str:
        """What would measure a parameter."""
        if not parameter.by:
            return "no device measures it"
        nouns = {name: kinds()[name].noun for name in parameter.by}
        here = [noun for name, noun in nouns.items() if name in self._config.of_one_world().devices()]
        if here:
            return f"nothing yet; {' or '.join(here)}, as the robot moves"
        return f"nothing on this bench; add {' or '.join(nouns.values())}"

    def must_agree(self) -> None:
        """Refuse to move a robot by a bench file that is contradicted.

        Raises:
            ConfigError: names the key, and the value that the measurement speaks for.
        """
        texts = dict.fromkeys(check.text for check in self.contradicted().values())
        if texts:
            raise ConfigError(
                f"{self._config.name}: {'; '.join(texts)}; nothing is moved",
                expected="measurements that agree with the bench file",
                remedy="; ".join(dict.fromkeys(map(advice, self.contradicted().values()))),
            )


def _rests_on(keys: Sequence[str]) -> str:
    """Words for a measurement that takes other keys as right, which nothing else confirms."""
    verb = "is" if len(keys) == 1 else "are"
    return f"if {' and '.join(keys)} {verb} right, which nothing else measures"


def _of_the_record(check: CrossCheck, kept: Mapping[str, Confirmation]) -> CrossCheck:
    """What the robot's record says of an unconfirmed parameter whose value is still the same."""
    one = kept.get(check.key)
    if check.state != "unconfirmed" or one is None or not one.holds_for(check.value):
        return check
    off, within = (math.nan if v is None else v for v in (one.difference, one.within))
    return CrossCheck(
        check.key,
        check.value,
        "confirmed",
        one.by,
        check.value,
        off,
        on=one.measured[:10],
        within=within,
        unit=one.unit,
    )


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, (list, tuple)):
        return [_times(part, factor) for part in value]
    return value * factor if isinstance(value, (int, float)) else math.nan


def advice(check: CrossCheck) -> str:
    """What to do about a contradiction."""
    says = check.to_json()["says"]
    if says is None:
        return f"correct {check.key}"
    return f"{check.key} = {shown(says)} would fit {check.by}"


def shown(value: Any) -> str:
    """A value as the bench file has it, numbers with four digits."""
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(shown, value)) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
