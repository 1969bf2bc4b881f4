"""`calibration.toml`: a calibration as a versioned file that is never overwritten.

Before an existing file is overwritten, it is copied to `NAME.vN.toml`; the new file names it, with its
SHA-256, as the previous version. So every state can be restored (`hil.calibration.versions`).
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hil.calibration.parameters import (
    Four,
    Parameters,
    Row,
    Tyres,
    impossible_nominal,
    impossible_twist,
    impossible_tyres,
    impossible_wheels,
)
from hil.config.robot_record.parts import Identity
from hil.core.errors import ConfigError, reason_of
from hil.core.geometry import Array
from hil.datasets.azimuth_coupling import Coupling
from hil.datasets.duplicates import wheel_fingerprint
from hil.robot.kinematics import ForwardModel, WheelGeometry
from hil.support.atomic_files import put_whole
from hil.support.file_reading import read_toml

if TYPE_CHECKING:
    from hil.calibration.calibrate import Calibration

FourNumbers = tuple[int, int, int, int]

WHEEL_ORDER: Literal["FL BL BR FR"] = "FL BL BR FR"
"""Order of the four numbers of every list in a file."""


class MadeFor(BaseModel):
    """Servos that a calibration was made with; lists in wheel order FL, BL, BR, FR.

    Signs and zeros are included because calibrated steering angles are measured from them. `servo_model` is
    None where the bench file names none.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    servo_model: int | None = None
    drive_ids: FourNumbers
    steer_ids: FourNumbers
    drive_sign: FourNumbers
    steer_sign: FourNumbers
    steer_zero_rad: Four


class CalibrationFile(BaseModel):
    """Content of `calibration.toml`, schema 1.

    Attributes:
        recordings: recordings of the fit, by name: motion, digests of the files, wheels
            (`hil.datasets.duplicates.wheel_fingerprint`) and weight.
        verdict: verdict of the validation run on the bench; empty without such a run.
        made_for: servos that it was made with, None for recordings of unknown origin.
        robot: robot that it belongs to; None where the bench is not known.
        tyres: loads and creep ratio, for `creep` and `dry-friction`; None for equal loads.
        driven_m: distance that its recordings drove in each direction (`hil.calibration.excitation`); empty
            where it is not known.
        coupling: turns of the drive encoders per turn of the steering that were taken out of its recordings.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)
    schema_version: Literal[1] = Field(alias="schema")
    version: int = Field(ge=1)
    created: str
    wheel_order: Literal["FL BL BR FR"] = WHEEL_ORDER
    method: str
    setting: str
    model: ForwardModel
    signal: Literal["position", "velocity"]
    parameters: Parameters
    nominal: Parameters
    std: dict[str, list[float]]
    twist_correction: tuple[Row, Row, Row]
    cost_before: float
    cost_after: float
    recordings: dict[str, dict[str, Any]]
    validation: dict[str, dict[str, dict[str, float]]] = {}
    warnings: list[str] = []
    software: dict[str, str] = {}
    previous: dict[str, str] = {}
    verdict: Literal["", "PASS", "MARGINAL", "FAIL"] = ""
    made_for: MadeFor | None = None
    robot: Identity | None = None
    tyres: Tyres | None = None
    driven_m: dict[str, Any] = {}
    coupling: Four | None = None

    @model_validator(mode="after")
    def _tyres_known(self) -> CalibrationFile:
        if self.model == "creep" and self.tyres is None:
            raise ValueError("tyres: the model creep needs their load and creep_ratio")
        return self

    @property
    def geometry(self) -> WheelGeometry:
        """The calibrated geometry."""
        return _geometry(self.parameters, self.tyres)

    @property
    def nominal_geometry(self) -> WheelGeometry:
        """Nominal geometry that the fit started from; the twist correction belongs to it."""
        return _geometry(self.nominal, self.tyres)

    @property
    def twist(self) -> Array:
        """Twist correction (3, 3)."""
        return np.array(self.twist_correction)


def coupling_of(file: CalibrationFile) -> Coupling | None:
    """Coupling that was taken out of the recordings of a calibration, and is to be taken out of others."""
    return None if file.coupling is None else Coupling(file.coupling)


def _geometry(p: Parameters, tyres: Tyres | None) -> WheelGeometry:
    wheels = WheelGeometry.from_vector([*p.x_w_m, *p.y_w_m, *p.r_m, *p.delta0_rad])
    return wheels if tyres is None else wheels.with_tyres(tyres.load, tyres.creep_ratio)


def read_calibration(path: Path) -> CalibrationFile:
    """Read and check a file; raises `ConfigError` that lists every problem."""
    tree = read_toml(path, remedy="run hil calibrate --out")
    if not tree.keys() & (CalibrationFile.model_fields.keys() - {"schema_version"}):
        raise ConfigError(
            f"{path}: is {'no calibration' if tree else 'empty'}",
            expected="a file that hil calibrate --out FILE wrote",
            remedy="name another file, or calibrate anew",
        )
    if (order := tree.get("wheel_order", WHEEL_ORDER)) != WHEEL_ORDER:
        raise ConfigError(
            f"{path}: wheel_order is {order!r}",
            expected=f"{WHEEL_ORDER!r}, in which every list of four numbers is read",
            remedy="put all lists of the file in that order, then correct wheel_order; or calibrate anew",
        )
    try:
        file = CalibrationFile.model_validate(tree)
    except ValidationError as error:
        problems = tuple(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise ConfigError(f"{path}: not a calibration of schema 1", problems=problems) from None
    _check_possible(file, f"{path}: no robot can be driven with this calibration")
    return file


def _check_possible(file: CalibrationFile, message: str) -> None:
    """Raise `ConfigError` that lists every implausible number."""
    problems = list(impossible_nominal(file.nominal))
    if not problems:
        problems += impossible_wheels(file.parameters, file.nominal)
    problems += impossible_twist(file.twist_correction)
    if file.tyres is not None:
        problems += impossible_tyres(file.tyres)
    if problems:
        raise ConfigError(
            message, problems=tuple(problems), remedy="put an earlier version back, or calibrate anew"
        )


def calibration_file(
    result: Calibration,
    *,
    created: str,
    software: Mapping[str, str],
    version: int = 1,
    previous: Mapping[str, str] | None = None,
    verdict: str = "",
    made_for: MadeFor | None = None,
    robot: Identity | None = None,
) -> CalibrationFile:
    """Make the content of a calibration file from a result.

    Args:
        result: calibration to store.
        created: date and time, ISO 8601.
        software: package versions that it was made with.
        version: number of this version.
        previous: name and SHA-256 of the version before.
        verdict: verdict of its validation run, empty without one.
        made_for: servos that it was made with.
        robot: robot that it belongs to.
    """
    described: Any = result.to_json()
    tree: dict[str, Any] = {
        "schema": 1,
        "version": version,
        "created": created,
        "wheel_order": WHEEL_ORDER,
        **{k: described[k] for k in ("method", "setting", "model", "signal", "cost_before", "cost_after")},
        "parameters": result.geometry.to_json(),
        "nominal": result.nominal.to_json(),
        "std": {k: [_finite(x) for x in v] for k, v in described["std"].items()},
        "twist_correction": result.twist.tolist(),
        "recordings": {
            r.name: {
                "motion": r.motion,
                "sha256": list(r.sha256),
                "wheels": wheel_fingerprint(r),
                "weight": float(w),
            }
            for r, w in zip(result.recordings, result.fit.problem.weights, strict=True)
        },
        "validation": result.validation,
        "warnings": list(result.warnings),
        "software": dict(software),
        "previous": dict(previous or {}),
        "verdict": verdict,
        "made_for": made_for,
        "robot": robot,
        "driven_m": result.driven.to_json(),
        "coupling": next((r.coupling for r in result.recordings if r.coupling), None),
    }
    if result.setting.model in ("creep", "dry-friction"):
        tree["tyres"] = result.geometry.tyres()
    return CalibrationFile.model_validate(tree)


def save_calibration(path: Path, file: CalibrationFile) -> None:
    """Write a file atomically: a reader gets the old or the new content, never a part.

    Raises:
        ConfigError: the file cannot be written, or its numbers are implausible, so that no reader accepts it.
    """
    _check_possible(file, f"{path}: not written, no robot can be driven with this calibration")
    text = tomli_w.dumps(file.model_dump(mode="python", by_alias=True, exclude_none=True))
    try:
        put_whole(path.resolve(), text.encode())  # a link stays one
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({reason_of(error)})") from None


def write_calibration(
    path: Path,
    result: Calibration,
    *,
    created: str,
    software: Mapping[str, str],
    made_for: MadeFor | None = None,
    robot: Identity | None = None,
) -> CalibrationFile:
    """Write a calibration; an older file of that name is first kept under its version number.

    Args:
        path: file to write.
        result: calibration to write.
        created: date and time, ISO 8601.
        software: package versions that it was made with.
        made_for: servos that it was made with, where the bench is known.
        robot: robot that it belongs to, where the bench is known.
    """
    previous, version = _keep_previous(path)
    file = calibration_file(
        result,
        created=created,
        software=software,
        version=version,
        previous=previous,
        made_for=made_for,
        robot=robot,
    )
    save_calibration(path, file)
    return file


def kept_path(path: Path, version: int) -> Path:
    """Path at which a version of `path` is kept: `calibration.toml` -> `calibration.v3.toml`."""
    return path.with_name(f"{path.stem}.v{version}{path.suffix}")


def next_version(path: Path) -> int:
    """One more than the highest version of `path` that exists, kept or in place."""
    pattern = re.compile(re.escape(path.stem) + r"\.v(\d+)" + re.escape(path.suffix))
    kept = [int(m[1]) for p in path.parent.glob("*") if (m := pattern.fullmatch(p.name))]
    return 1 + max([*kept, read_calibration(path).version if path.exists() else 0])


def _finite(value: float | None) -> float:
    return float("nan") if value is None else value


def _keep_previous(path: Path) -> tuple[dict[str, str], int]:
    if not path.exists():
        return {}, next_version(path)
    return keep(path), next_version(path)


def keep(path: Path) -> dict[str, str]:
    """Copy the file in place to its version's path; return its name and SHA-256.

    Raises:
        ConfigError: a file with other content is kept under that number, or the copy cannot be written.
    """
    old = read_calibration(path)
    kept, content = kept_path(path, old.version), path.read_bytes()
    if not kept.exists():
        try:
            put_whole(kept, content)
        except OSError as error:
            raise ConfigError(f"{kept}: cannot be written ({reason_of(error)})") from None
    elif kept.read_bytes() != content:
        raise ConfigError(
            f"{kept}: exists and differs from version {old.version} in {path}", remedy="move one of them away"
        )
    return {"file": kept.name, "sha256": hashlib.sha256(content).hexdigest()}
