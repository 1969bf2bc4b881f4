"""Controller and estimator, the two roles of code of the user: checks a name, makes what it names."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.core.errors import UsageError, did_you_mean
from hil.core.known_names import COMPARED, LAWS
from hil.user_code.named_class import make_named, maker_of


@dataclass(frozen=True)
class Role:
    """A role in the loop that a class or function of the user may have.

    Attributes:
        option: option of the command line that names it.
        shipped: names of what is shipped for this role.
        methods: methods that it must have, with the names of their arguments.
        expected: description of the methods, for errors.
    """

    option: str
    shipped: Sequence[str]
    methods: Mapping[str, Sequence[str]]
    expected: str

    def check(self, named: str) -> None:
        """Check that a name can be loaded, before anything is opened; or that it is a shipped one.

        Args:
            named: shipped name, `FILE.py:NAME` or `MODULE:NAME`.

        Raises:
            UsageError: neither a shipped name nor one with a colon.
            ConfigError: no such file, module or name, loading fails, or it cannot be called as it will be.
        """
        if named in self.shipped:
            return
        if ":" not in named:
            expected = ", ".join(self.shipped) + ", or FILE.py:NAME or MODULE:NAME of your own"
            is_file = named.endswith(".py")
            remedy = (
                f"name the class in it, as {named}:NAME" if is_file else did_you_mean(named, self.shipped)
            )
            raise UsageError(f"{self.option} {named!r} is unknown", expected=expected, remedy=remedy)
        maker_of(named, self.option, self.methods)

    def make(self, named: str, bench: object) -> Any:
        """Make the user's object: call NAME with the bench's model if it takes an argument, else without.

        Args:
            named: `FILE.py:NAME` or `MODULE:NAME`.
            bench: model of the bench (`hil.bench.pipelines.BenchModel`).

        Raises:
            ConfigError: NAME is refused by `check` or fails, or its result lacks a method.
        """
        return make_named(named, self.option, self.methods, bench, expected=self.expected)


CONTROLLER = Role(
    "--controller",
    LAWS,
    {"reset": (), "update": ("state", "reference", "wheels")},
    "reset(), and update(state, reference, wheels) that returns a WheelSetpoint",
)
ESTIMATOR = Role(
    "--estimator",
    COMPARED,
    {"reset": ("state",), "update": ("measurements",)},
    "reset(state), and update(measurements) that returns a RobotState",
)
