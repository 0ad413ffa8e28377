"""Files that an option names, by path and digest: `--mesh` and `--plugin`."""

from __future__ import annotations

import hashlib
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


class GivenFile(BaseModel):
    """A file: where it is, and the SHA-256 of what was in it when the run was asked for."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str
    sha256: str


class MeshFile(GivenFile):
    """A bristle's mesh."""

    def read(self) -> OwnMesh:
        """What is in it; MeshError where that is no bristle."""
        from ...meshes.own import own_mesh

        return own_mesh(Path(self.path), self.sha256)


class PluginFile(GivenFile):
    """Python with effects of the user's own."""


def read_mesh_file(value: Any) -> Any:
    """A `MeshFile` of a path, or of an earlier run's path and digest, checked against the file.

    Raises ValueError where the file is no mesh of a bristle, or has changed since.
    """
    value = _by_path(value)
    if not _has_path(value):
        return value
    from ...meshes.check import MeshError
    from ...meshes.own import digest

    try:
        file = MeshFile(**_unchanged(value, digest(Path(value["path"])), "--mesh"))
        file.read()
    except MeshError as error:
        raise ValueError(str(error)) from error
    return file


def read_plugins(value: Any) -> Any:
    """`PluginFile`s of paths, or of an earlier run's paths and digests; their effects are taken in.

    Raises ValueError where a file is no Python, an effect is refused, or the file has changed.
    """
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of Python files, not {value!r}")
    return tuple(_read_plugin(item) for item in value)


def _read_plugin(value: Any) -> Any:
    value = _by_path(value)
    if not _has_path(value):
        return value
    from ...solver.effects.outside import load

    path = Path(value["path"])
    try:
        source = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None
    file = PluginFile(**_unchanged(value, hashlib.sha256(source).hexdigest(), "--plugin"))
    load(path, source)
    return file


def _by_path(value: Any) -> Any:
    return {"path": str(Path(value).resolve())} if isinstance(value, str | Path) else value


def _has_path(value: Any) -> bool:
    return isinstance(value, dict) and isinstance(value.get("path"), str)


def _unchanged(value: dict[str, Any], now: str, option: str) -> dict[str, Any]:
    """``value`` with its file's digest, which is ``now``; ValueError where it was another."""
    before = value.get("sha256", now)
    if before != now:
        raise ValueError(
            f"{value['path']} has changed since that run: its SHA-256 was {str(before)[:12]}…, and "
            f"is {now[:12]}…; name it with {option} to take it as it is"
        )
    return {**value, "sha256": now}
