"""Warnings about applying a calibration: what it was fitted to, and where its use differs.

Errors on recordings used in the fit do not show the errors on others. The parameters belong to one forward
model and one wheel signal; with another model or signal the same recordings give other parameters.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hil.calibration.calibration_file import CalibrationFile
from hil.datasets.duplicates import same_wheels, wheel_fingerprint
from hil.datasets.wheel_log import Recording


@dataclass(frozen=True)
class InSample:
    """Those of the given recordings that a calibration was fitted to.

    Attributes:
        names: recordings that it was fitted to, recognised by the digest of a file or by their wheels.
        among: number of given recordings.
        known: True if the calibration records what it was fitted to.
    """

    names: tuple[str, ...]
    among: int
    known: bool

    def to_json(self) -> dict[str, object]:
        """`{"count": 2, "of": 24, "names": [...]}`; `count` is None where it is not known."""
        return {"count": len(self.names) if self.known else None, "of": self.among, "names": list(self.names)}

    def in_words(self) -> str:
        """One line for tables and pages."""
        if not self.known:
            return "in sample or not: the calibration does not record which files it was fitted to"
        if not self.names:
            return f"held out: the calibration was fitted to none of these {self.among} recordings"
        return (
            f"in sample: the calibration was fitted to {len(self.names)} of these {self.among} recordings; "
            "errors on them do not say how it does on others"
        )


def in_sample(file: CalibrationFile, recordings: Sequence[Recording]) -> InSample:
    """Find the recordings that a calibration was fitted to: same bytes or same wheels, under any name.

    Args:
        file: the calibration.
        recordings: recordings that it is applied to.
    """
    digests = {digest for used in file.recordings.values() for digest in _digests(used.get("sha256"))}
    wheels = [numbers for used in file.recordings.values() if (numbers := _numbers(used.get("wheels")))]
    short = [wheel_fingerprint(r) for r in recordings]
    names = tuple(
        r.name
        for r, own in zip(recordings, short, strict=True)
        if digests.intersection(r.sha256) or any(same_wheels(own, kept) for kept in wheels)
    )
    return InSample(names, len(recordings), bool(digests or wheels))


def _digests(found: object) -> Iterable[str]:
    return (str(digest) for digest in found) if isinstance(found, list) else ()


def _numbers(found: object) -> list[float]:
    numbers = found if isinstance(found, list) else []
    return numbers if all(isinstance(number, (int, float)) for number in numbers) else []


def used_otherwise(file: CalibrationFile, model: str | None, signal: str, deploy: str) -> list[str]:
    """Warnings, one sentence each, where a calibration is used with another model or signal than fitted.

    Args:
        file: the calibration.
        model: requested forward model, None for the calibration's own.
        signal: wheel signal in use.
        deploy: `parameters` or `twist`.
    """
    out = []
    if deploy == "twist" and model is not None:
        out.append(
            f"--model {model} has no effect with --deploy twist, which corrects odometry by the model exact"
        )
    elif model is not None and model != file.model:
        out.append(
            f"--model {model}: the calibration was fitted with the model {file.model}, and its parameters "
            "hold for that one only; leave --model out, or calibrate with it"
        )
    if signal != file.signal:
        out.append(
            f"--signal {signal}: the calibration was fitted with the signal {file.signal}, and its "
            "parameters hold for that one only; leave --signal out, or calibrate with it"
        )
    return out
