"""How the bench waits for a controller on ROS 2 (`[ros2]` of the bench file)."""

from __future__ import annotations

from typing import Annotated

from hil.config.values import Strict, Within


class Ros2Config(Strict):
    """A controller on ROS 2 (`--controller ros2:TOPIC`).

    Attributes:
        wait_share: in real time, share of a cycle for which the loop waits for the answer to what it has just
            published; then the newest command counts. 0 waits for none.
        late_after_s: age at which the newest command is too old: the robot stops.
        answer_timeout_s: in virtual time, by the host's clock, how long a cycle waits for its command.
        start_timeout_s: how long a run waits for the first command; `hil live` waits for as long as it takes.
    """

    wait_share: Annotated[float, Within(0.0, 0.8, "the rest of the cycle is the bench's")] = 0.3
    late_after_s: Annotated[float, Within(0.02, 5.0, "wheels go on turning meanwhile")] = 0.2
    answer_timeout_s: Annotated[float, Within(0.05, 60.0, "a minute for a slow computer")] = 1.0
    start_timeout_s: Annotated[float, Within(0.1, 600.0, "ten minutes for one that is built first")] = 10.0
