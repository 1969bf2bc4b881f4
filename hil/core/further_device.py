"""A further device of a kind on one bench: a second range finder, another IMU.

The rest of the bench treats it as a separate kind, called `KIND_NAME` (`rangefinder_rear`), with its own
table, samples, faults, topics, columns and plots. The kind's methods are called with inputs in which the
samples of the further device are stored under the kind's name.
"""

import re
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

from hil.core.device import DeviceKind, DeviceModel, Figures, Force, Plot, Topic
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import KINDS, Inputs

LABEL_RULE = "lower case letters, digits and _, beginning with a letter"
_LABEL = re.compile("[a-z][a-z0-9_]*")


def is_label(name: object) -> bool:
    """Whether a name is valid for one of several devices of a kind."""
    return isinstance(name, str) and _LABEL.fullmatch(name) is not None


def in_place_of(name: str, kind: str, inputs: Inputs) -> Inputs:
    """Inputs with the samples of the device `name` stored as those of its kind.

    Args:
        name: name of a further device.
        kind: name of its kind.
        inputs: inputs of a cycle.
    """
    own = {kind: inputs.of(name)}
    changed: dict[str, Any] = own if kind in KINDS else {"added": {**inputs.added, **own}}
    return replace(inputs, **changed)


class FurtherKind(DeviceKind):
    """A device kind under the name of one further device.

    Args:
        kind: the existing kind.
        label: the device's `name` in the bench file.

    Attributes:
        of: name of the kind.
        label: the device's name among those of its kind.
    """

    def __init__(self, kind: DeviceKind, label: str) -> None:
        self.__dict__.update({key: getattr(kind, key) for key in DeviceKind.__annotations__})
        self._kind, self.of, self.label = kind, kind.name, label
        about = {
            "name": f"{kind.name}_{label}",
            "noun": f"{label.replace('_', ' ')} {kind.noun}",
            "aliases": tuple(f"{alias}_{label}" for alias in kind.aliases),
            "endpoint": "",
            "topics": tuple(self._topic(topic) for topic in kind.topics),
            "plots": tuple(self._plot(plot) for plot in kind.plots),
        }
        self.__dict__.update(about)
        self.models = tuple(_further_model(model, self.name) for model in kind.models)

    def _topic(self, topic: Topic) -> Topic:
        return Topic(f"{topic.name}_{self.label}", topic.type, partial(self._message, topic))

    def _message(self, topic: Topic, sample: Any, ros: Any) -> Any:
        return topic.message(sample, ros.with_names(self.own))

    def _plot(self, plot: Plot) -> Plot:
        return Plot(plot.tab, f"{plot.title}, {self.label}", self._entity(plot.entity))

    def _entity(self, entity: str) -> str:
        return f"{entity}_{self.label}"

    def own(self, text: str) -> str:
        """Replace the kind's name at the start of `text` by the device's; other text is unchanged.

        The kind's name must be all of `text`, or be followed by a dot or underscore.
        """
        begins = text == self.of or text.startswith((f"{self.of}.", f"{self.of}_"))
        return self.name + text.removeprefix(self.of) if begins else text

    def alone(self, inputs: Inputs) -> Inputs:
        """Inputs in which this device is the only one of its kind."""
        return in_place_of(self.name, self.of, inputs)

    def stale_after_s(self, safety: Any, config: Any) -> float | None:
        """Same as the kind."""
        return self._kind.stale_after_s(safety, config)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """Same as the kind."""
        return self._kind.rate_hz(config, loop_hz)

    def checks(self, config: Any) -> Sequence[Any]:
        """Checks of the kind; the caller must give them cycles whose inputs went through `alone`."""
        return self._kind.checks(config)

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Figures of the kind, with the device's own entity names."""
        for entity, figures in self._kind.figures(self.alone(inputs)):
            yield self._entity(entity), figures

    def forces(self, inputs: Inputs, robot: Any, config: Any) -> Iterator[Force]:
        """Forces of the kind, with the device's label in their names."""
        for force in self._kind.forces(self.alone(inputs), robot, config):
            yield force._replace(name=f"{force.name} {self.label}")

    def motion_value(self, sample: Any) -> Array | None:
        """Value (k,), same as the kind."""
        return self._kind.motion_value(sample)

    def check(self, watched: Any) -> Iterator[Finding]:
        """Same as the kind."""
        return self._kind.check(watched)


def _further_model(model: DeviceModel, name: str) -> DeviceModel:
    """Copy of a model for a further device; on CAN it is served at its own multicast group."""
    made = copy(model)
    made.__dict__.update({"kind": name, "subnet": 0})
    return made
