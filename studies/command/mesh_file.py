"""The option `--mesh`: a mesh file by path and digest, and the options that it excludes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

if TYPE_CHECKING:
    from ...meshes.own import OwnMesh

# What a mesh file says itself.
REPLACED = (
    "length_m",
    "width_m",
    "thickness_m",
    "diameter_m",
    "cells",
    "grading",
    "geometry_order",
)


class MeshFile(BaseModel):
    """A mesh file: where it is, and the SHA-256 of what was in it when the run was asked for."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str
    sha256: str

    def read(self) -> OwnMesh:
        """What is in it; MeshError where that is no bristle."""
        from ...meshes.own import own_mesh

        return own_mesh(Path(self.path), self.sha256)


def read_mesh_file(value: Any) -> Any:
    """A `MeshFile` of a path, or of an earlier run's path and digest, checked against the file.

    Raises ValueError where the file is no mesh of a bristle, or has changed since.
    """
    if isinstance(value, str):
        value = {"path": str(Path(value).resolve())}
    if not isinstance(value, dict) or not isinstance(value.get("path"), str):
        return value
    from ...meshes.check import MeshError
    from ...meshes.own import digest

    try:
        now = digest(Path(value["path"]))
        before = value.setdefault("sha256", now)
        if before != now:
            raise ValueError(
                f"{value['path']} has changed since that run: its SHA-256 was {str(before)[:12]}…, "
                f"and is {now[:12]}…; name it with --mesh to take it as it is"
            )
        file = MeshFile(**value)
        file.read()
    except MeshError as error:
        raise ValueError(str(error)) from error
    return file
