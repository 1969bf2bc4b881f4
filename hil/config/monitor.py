"""Looks of the robot in the monitor (`[monitor]` of the bench file)."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator

from hil.config.device import Position
from hil.config.field_types import Strict, UnitQuaternion, Within

MESHES = (".glb", ".gltf", ".obj", ".stl")


class MonitorConfig(Strict):
    """Looks of the robot in the three-dimensional view.

    Attributes:
        mesh: file of the robot's body (`.glb`, `.gltf`, `.obj`, `.stl`), drawn instead of the one that is
            made from `[robot]`; wheels are drawn from `[robot]` in any case, because they steer and turn.
        mesh_unit_m: length of the file's unit: 0.001 for a file in mm.
        mesh_position_m, mesh_rotation_wxyz: the file's frame in the body (x forward, y left, z out of the
            surface, zero on the surface).
    """

    mesh: str | None = Field(None, min_length=1)
    mesh_unit_m: Annotated[float, Within(1e-6, 10.0, "0.001 for mm, 1 for m")] = 1.0
    mesh_position_m: Position = (0.0, 0.0, 0.0)
    mesh_rotation_wxyz: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)

    @field_validator("mesh")
    @classmethod
    def _known_format(cls, value: str | None) -> str | None:
        if value is not None and Path(value).suffix.lower() not in MESHES:
            raise ValueError(f"{value} is no mesh that can be shown; expected one of {', '.join(MESHES)}")
        return value
