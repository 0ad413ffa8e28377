"""The option `--plugin`: Python files with effects of the user's own, by path and digest."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict


class PluginFile(BaseModel):
    """A file with effects, and the SHA-256 of what was in it when the run was asked for."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str
    sha256: str


def read_plugins(value: Any) -> Any:
    """Take in the effects of files, given by path or as an earlier run names them.

    Raises ValueError where a file is no Python, an effect is refused, or the file has changed.
    """
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of Python files, not {value!r}")
    return tuple(_read(item) for item in value)


def _read(item: Any) -> PluginFile:
    from ...solver.effects.outside import load

    if isinstance(item, str | Path):
        item = {"path": str(Path(item).resolve())}
    given = {"sha256": "", **item} if isinstance(item, dict) else item
    file = PluginFile.model_validate(given)
    try:
        now = hashlib.sha256(Path(file.path).read_bytes()).hexdigest()
    except OSError as error:
        raise ValueError(f"{file.path}: {error.strerror}") from None
    if file.sha256 not in ("", now):
        raise ValueError(
            f"{file.path} has changed since that run: its SHA-256 was {file.sha256[:12]}…, and is "
            f"{now[:12]}…; name it with --plugin to take it as it is"
        )
    load(Path(file.path))
    return PluginFile(path=file.path, sha256=now)
