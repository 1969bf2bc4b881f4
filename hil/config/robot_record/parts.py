"""One version of a robot's record as a model: its robot, its parts, and their consistency.

A part is what one procedure found: values for keys of the bench file, and figures for people and other
procedures. `made_with` remembers what it was measured on top of, so that parts which do not belong together
are found.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from hil.config.robot_record.limits import not_plain
from hil.core.cross_check import Unit, bound_text

Four = tuple[float, float, float, float]
FourNumbers = tuple[int, int, int, int]
_SAME_M = 1e-6
NOT_VERIFIED = "not verified"
"""Verdict of a part that was taken from a file which does not say how its run ended."""


@dataclass(frozen=True)
class PartKind:
    """Permitted content of a part.

    Attributes:
        title: short description of the part.
        keys: dotted keys of the bench file; one that ends in a dot stands for all below it.
        measured_by: procedure that finds it.
        on: parts that it is measured on top of.
        yields: True if the bench file overrides the part; else the part overrides the bench file.
    """

    title: str
    keys: tuple[str, ...]
    measured_by: str
    on: tuple[str, ...] = ()
    yields: bool = False


PARTS: Mapping[str, PartKind] = {
    "signs": PartKind(
        "which way drives, steering axes and encoders turn",
        ("alignment.drive_sign", "alignment.steer_sign", "encoders.sign"),
        "bring_up",
    ),
    "steering": PartKind(
        "external steering encoders against their servos",
        ("encoders.minus_servo_rad",),
        "bring_up",
        ("signs",),
    ),
    "zeros": PartKind(
        "zeros of the steering axes", ("alignment.steer_zero_rad",), "steering_zero", ("signs",)
    ),
    "backlash": PartKind("whole backlash of the steering gears", (), "steering_zero", ("signs",)),
    "geometry": PartKind(
        "wheel positions, radii, loads and tyres",
        ("calibration",),
        "odometry_calibration",
        ("signs", "zeros"),
    ),
    "camera": PartKind(
        "mount, scale and latency of the tracking camera",
        (
            "tracker.mount_position_m",
            "tracker.mount_rotation_wxyz",
            "tracker.scale",
            "tracker.scale_sigma",
            "tracker.latency_s",
        ),
        "tracker_extrinsics",
    ),
    "inertial": PartKind(
        "offsets, noise and mount of the inertial unit",
        ("imu.calibration_file", "imu.mount_rotation_wxyz"),
        "imu_calibration",
    ),
    "delays": PartKind("delays from command to motion and to knowledge", (), "latency"),
    "slip": PartKind(
        "slip per metre, by direction",
        ("estimator.wall.", "environment.friction"),
        "surface_identification",
        ("signs", "zeros", "geometry"),
    ),
    "noise": PartKind(
        "noise and drift of the sensors, and how the robot shakes",
        (
            "estimator.process.",
            "estimator.wheels.step_m",
            "estimator.wheels.per_sqrt_m",
            "estimator.gyro.rate_rad_s",
            "estimator.tracker.position_m",
            "estimator.tracker.heading_rad",
            "estimator.tracker.drift_per_sqrt_m",
            "estimator.tracker.drift_per_sqrt_s",
            "estimator.tracker.yaw_drift_per_sqrt_s",
            "estimator.mocap.position_m",
            "estimator.mocap.heading_rad",
        ),
        "sensor_noise",
        ("geometry",),
        yields=True,
    ),
    "hold": PartKind(
        "zeros of the load cells and force of the fan",
        ("adhesion.rated_force_n", "adhesion.rated_rpm", "load_cells.zero_n"),
        "adhesion_check",
    ),
}


def part_of(key: str) -> str | None:
    """The part that may hold a key of the bench file; None for a key that no part holds."""
    for name, kind in PARTS.items():
        if any(key == k or (k.endswith(".") and key.startswith(k)) for k in kind.keys):
            return name
    return None


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True, allow_inf_nan=False)


class Figure(_Model):
    """A measured number; `sigma` is its standard uncertainty, None where it is unknown."""

    value: float
    sigma: float | None = Field(None, ge=0)
    unit: str = "1"


class Spread(_Model):
    """Covariance of several values: `matrix` in the order of `names`."""

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _square(self) -> Spread:
        if any(len(row) != len(self.names) for row in self.matrix) or len(self.matrix) != len(self.names):
            raise ValueError(f"covariance of {len(self.names)} names is no square matrix of that size")
        return self


class Part(_Model):
    """Findings of one procedure.

    Attributes:
        procedure, verdict: the procedure that measured it, and how its run ended; `not verified` of a file
            that does not say.
        measured: date and time, ISO 8601.
        bench: name of the bench.
        surface: surface that it holds for; empty for everywhere.
        until: last day on which it may be used, ISO 8601; empty without end.
        recordings: SHA-256 of the files that it was found in, by name.
        values: dotted keys of the bench file -> value. For a file it is a name in the record's `files`.
        files: SHA-256 of such files, by key.
        figures: measured numbers by name.
        covariance: covariance of some of them.
        made_with: digests of the parts that it was measured on top of.
    """

    procedure: str
    verdict: Literal["PASS", "MARGINAL", "not verified"]
    measured: str
    bench: str
    surface: str = ""
    until: str = ""
    recordings: dict[str, str] = {}
    values: dict[str, Any] = {}
    files: dict[str, str] = {}
    figures: dict[str, Figure] = {}
    covariance: Spread | None = None
    made_with: dict[str, str] = {}

    @field_validator("values")
    @classmethod
    def _plain(cls, value: dict[str, Any]) -> dict[str, Any]:
        if problems := [f"{key}: {text}" for key, one in value.items() for text in not_plain(one)]:
            raise ValueError("; ".join(dict.fromkeys(problems)))
        return value

    @field_validator("until")
    @classmethod
    def _a_day(cls, value: str) -> str:
        if value:
            date.fromisoformat(value)
        return value

    def digest(self) -> str:
        """Digest of what other parts may depend on: the values, and the files by their content."""
        return digest_of({"values": {**self.values, **self.files}})

    def over(self, today: date) -> bool:
        """Whether the validity of the part has ended."""
        return bool(self.until) and today > date.fromisoformat(self.until)


class Confirmation(_Model):
    """A key of the bench file that a measurement has confirmed.

    Attributes:
        value: value that was confirmed; any other is not.
        by: the measurement.
        procedure, measured: procedure in which it was measured; date and time, ISO 8601.
        difference: difference of the measurements, in `unit`; None where it gives none.
        within: difference up to which it confirms, in `unit`; None for a choice, such as a sign.
        unit: unit of both, `1` for a share of the value.
    """

    value: Any
    by: str
    procedure: str
    measured: str
    difference: float | None = None
    within: float | None = None
    unit: Unit = "1"

    @field_validator("value")
    @classmethod
    def _plain(cls, value: Any) -> Any:
        if problems := list(not_plain(value)):
            raise ValueError("; ".join(problems))
        return value

    @property
    def bound(self) -> str:
        """The bound in words; empty for none."""
        return bound_text(self.within, self.unit)

    def holds_for(self, value: Any) -> bool:
        """Whether a bench file still has the value that was confirmed."""
        return bool(_listed(self.value) == _listed(value))

    def alike(self, other: Confirmation) -> bool:
        """Whether another one says the same, at another time: only what is new makes a version."""
        mine, theirs = ((one.by, one.within, one.unit) for one in (self, other))
        return self.holds_for(other.value) and mine == theirs


def _listed(value: Any) -> Any:
    """A value with lists in the place of tuples, as a file has them."""
    return [_listed(one) for one in value] if isinstance(value, (list, tuple)) else value


class Identity(_Model):
    """The identity of a robot: name, servos and wheels on paper, as the bench file has them.

    `body` is the body behind it: `real`, or which emulated one; None where it was not said.
    """

    name: str
    body: str | None = None
    servo_model: int | None = None
    drive_ids: FourNumbers | None = None
    steer_ids: FourNumbers | None = None
    wheel_x_m: Four
    wheel_y_m: Four
    wheel_radius_m: Four

    def differences(self, other: Identity, place: str = "in the record") -> Iterator[str]:
        """Differences from another robot: `key: value PLACE, value here`; unknown values count as equal."""
        for key in Identity.model_fields:
            mine, theirs = getattr(self, key), getattr(other, key)
            if mine is None or theirs is None or mine == theirs:
                continue
            if key.startswith("wheel_") and all(
                abs(a - b) < _SAME_M for a, b in zip(mine, theirs, strict=True)
            ):
                continue
            yield f"{_KEYS[key]}: {_shown(mine)} {place}, {_shown(theirs)} here"


_KEYS = {
    "name": "robot.name",
    "body": "robot",
    "servo_model": "servos.model_number",
    "drive_ids": "servos.drive_ids",
    "steer_ids": "servos.steer_ids",
    "wheel_x_m": "robot.wheel_x_m",
    "wheel_y_m": "robot.wheel_y_m",
    "wheel_radius_m": "robot.wheel_radius_m",
}


def _shown(value: object) -> str:
    return repr(value) if isinstance(value, str) else str(value)


class RecordFile(_Model):
    """Content of `record.toml`, schema 1.

    Attributes:
        version, created: number, and date and time.
        why: origin of this version, in words.
        robot: robot that the record is of.
        parts: parts by name, see `PARTS`.
        confirmed: keys of the bench file that measurements have confirmed.
        previous: digest of the version before it, empty for the first.
        sha256: digest of everything else here.
    """

    schema_version: Literal[1] = Field(alias="schema")
    version: int = Field(ge=1)
    created: str
    why: str
    robot: Identity
    parts: dict[str, Part] = {}
    confirmed: dict[str, Confirmation] = {}
    previous: str = ""
    sha256: str = ""

    @field_validator("parts")
    @classmethod
    def _known_parts(cls, value: dict[str, Part]) -> dict[str, Part]:
        for name, part in value.items():
            if name not in PARTS:
                raise ValueError(f"{name} is no part; known are {', '.join(PARTS)}")
            for key in part.values:
                if part_of(key) != name:
                    raise ValueError(f"part {name} holds {key}, which belongs to {part_of(key) or 'no part'}")
        return value

    def tree(self) -> dict[str, Any]:
        """The version as written, without the digest."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True, exclude={"sha256"})

    def sealed(self) -> RecordFile:
        """The record with its digest filled in."""
        return self.model_copy(update={"sha256": digest_of(self.tree())})

    def contradictions(self) -> Iterator[str]:
        """Parts that were measured with other versions of the parts that they depend on."""
        for name, part in self.parts.items():
            for below, digest in part.made_with.items():
                there = self.parts.get(below)
                if there is None or there.digest() != digest:
                    what = "which is gone" if there is None else f"than the {below} of {there.measured}"
                    yield f"{name}: measured {part.measured} with other {below} {what}"

    def without_stale(self) -> tuple[RecordFile, tuple[str, ...]]:
        """The record without parts that were measured on top of other versions, and their names."""
        parts, gone = dict(self.parts), list[str]()
        while True:
            file = self.model_copy(update={"parts": parts})
            stale = [line.split(":", 1)[0] for line in file.contradictions()]
            if not stale:
                return file, tuple(gone)
            gone += dict.fromkeys(stale)
            parts = {name: part for name, part in parts.items() if name not in stale}


def digest_of(tree: object) -> str:
    """SHA-256 of a tree of JSON values, the same whatever the order of its keys."""
    text = json.dumps(tree, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
