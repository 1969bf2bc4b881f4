"""Network of the bench on ROS 2, and its waits for a controller there (`[ros2]` of the bench file)."""

import re
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field, field_validator

from hil.config.field_types import Strict, Within
from hil.core.known_names import HIGHEST_DOMAIN, DistributionName

_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


class Ros2Config(Strict):
    """The bench on ROS 2 (`--ros2`), and a controller there (`--controller ros2:TOPIC`).

    Attributes:
        domain: number of the DDS domain, where `--ros2-domain` names none; without it that of
            `ROS_DOMAIN_ID`, else 0.
        interface: network interface beside loopback, where `--ros2-interface` names none: every host that
            reaches it can read the bench, and drive it where it takes commands.
        distribution: distribution of ROS 2 on the other side: `humble`, `iron`, `jazzy`, `kilted`, `lyrical`
            or `rolling`: `ros2 node list` shows the bench there. Left out, it does not, because Humble
            describes nodes otherwise than later ones do.
        node: name that the bench has in that list.
        names: other names of topics that are published, by their own names:
            `names = { "/joint_states" = "/robot_joint_states" }`.
        wait_share: share of a cycle for which, in real time, the loop waits for the answer to what it has
            just published; then the newest command counts. 0 waits for none.
        late_after_s: age at which the newest command is too old: the robot stops.
        answer_timeout_s: longest wait of a cycle for its command in virtual time, by the host's clock.
        start_timeout_s: longest wait of a run for the first command; `hil live` waits for as long as it
            takes.
    """

    domain: (
        Annotated[int, Within(0, HIGHEST_DOMAIN, "above it ports run into those of any program")] | None
    ) = None
    interface: str | None = Field(None, min_length=1)
    distribution: DistributionName | None = None
    node: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=255)] = "hil_bench"
    names: Mapping[str, str] = {}
    wait_share: Annotated[float, Within(0.0, 0.8, "the rest of the cycle is the bench's")] = 0.3
    late_after_s: Annotated[float, Within(0.02, 5.0, "wheels go on turning meanwhile")] = 0.2
    answer_timeout_s: Annotated[float, Within(0.05, 60.0, "a minute for a slow computer")] = 1.0
    start_timeout_s: Annotated[float, Within(0.1, 600.0, "ten minutes for one that is built first")] = 10.0

    @field_validator("names")
    @classmethod
    def _topics(cls, value: Mapping[str, str]) -> Mapping[str, str]:
        for name in (*value, *value.values()):
            if not _TOPIC.fullmatch(name):
                raise ValueError(f"{name!r} is no name of a topic; expected one as /joint_states")
        if len(set(value.values())) < len(value):
            raise ValueError("two topics cannot have one name")
        return value
