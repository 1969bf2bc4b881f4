"""Judges one case of the campaign of wrong values by what was said and what was true."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from hil.core.event_rows import without_numbers
from hil.fault_matrix.wrong_values.cases import WrongValue
from hil.fault_matrix.wrong_values.observed import Observed, observe, without_mistake

Outcome = Literal["right", "misnamed", "harmless", "unconfirmed", "silent"]
OFF_M, OFF_RAD, ODOMETRY_M, FORCE_SHARE = 0.003, 0.01, 0.006, 0.1
"""Harmless changes of place, heading, odometry and true forces against the bench without a mistake."""


@dataclass(frozen=True)
class Verdict:
    """Verdict of one case.

    Attributes:
        case: the case.
        outcome: its verdict.
        what: description of what happened.
        named_by: stages that named the key.
    """

    case: WrongValue
    outcome: Outcome
    what: str
    named_by: tuple[str, ...] = ()


def lost(case: WrongValue, reason: str) -> Verdict:
    """Return the verdict of a case whose worker died."""
    return Verdict(case, "silent", reason)


def judged(case: WrongValue) -> Verdict:
    """Run one case and the bench without its mistake; return the verdict."""
    return judge(case, observe(case), without_mistake(case.bench, case.plant, case.seed))


def judge(case: WrongValue, seen: Observed, usual: Observed) -> Verdict:
    """Return the verdict of a case from its observations, and those of the bench without the mistake."""
    always = set(map(without_numbers, usual.texts()))
    stages = {"doctor": seen.doctor, "bring_up": seen.bring_up, "climb": seen.climb}
    news = {
        name: [t for t in told.texts if without_numbers(t) not in always] for name, told in stages.items()
    }
    named = tuple(name for name, texts in news.items() if any(case.key in text for text in texts))
    ended = [name for name, told in stages.items() if told.refused]
    harm = "; ".join(_harm(seen, usual))
    entry = seen.parameters.get(case.key, {})
    said = next(
        (text for name in (named or ended) for text in news[name] if case.key in text or not named), ""
    )
    contradicted = entry.get("state") == "contradicted" or case.key in seen.contradicted
    if named and (ended or not harm or contradicted):
        return Verdict(case, "right", said, named)
    if ended:
        return Verdict(case, "misnamed", said or harm, tuple(ended))
    if not harm:
        return Verdict(case, "harmless", said)
    if entry.get("state") == "unconfirmed":
        return Verdict(case, "unconfirmed", harm)
    return Verdict(case, "silent", harm)


def _harm(seen: Observed, usual: Observed) -> Iterator[str]:
    """Yield what was truly different, beyond what is harmless."""
    now, before = seen.truth, usual.truth
    if now.fell:
        yield "the robot fell or slid"
    if now.drove:
        apart_m = max(abs(a - b) for a, b in zip(now.reached_m, before.reached_m, strict=True))
        if apart_m > OFF_M:
            yield f"{1e3 * apart_m:.0f} mm off the goal"
        if abs(now.heading_rad - before.heading_rad) > OFF_RAD:
            yield f"heading {now.heading_rad - before.heading_rad:+.3f} rad off"
        if now.said_off_m > before.said_off_m + OFF_M:
            yield f"estimate {1e3 * now.said_off_m:.0f} mm off"
        if abs(now.said_off_rad) > abs(before.said_off_rad) + OFF_RAD:
            yield f"estimate {now.said_off_rad:+.3f} rad off"
        if now.odometry_off_m > before.odometry_off_m + ODOMETRY_M:
            yield f"odometry {1e3 * now.odometry_off_m:.0f} mm off"
    for what, is_n, was_n in (
        ("adhesion", now.adhesion_n, before.adhesion_n),
        ("thrust", now.thrust_n, before.thrust_n),
    ):
        if abs(is_n - was_n) > FORCE_SHARE * was_n:
            yield f"{what} {is_n:.1f} N, not {was_n:.1f}"
