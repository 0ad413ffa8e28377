"""Kinds of measured data: the program's own, those of installed packages, and of users' files.

A kind is a function that makes the folder of a dataset a `loop.problem.Problem`. A package names it
under the entry point `ENTRY_POINT`, by the kind's name; a file for ``--plugin`` holds a `Kind`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from ...solver.effects import outside
from ...solver.effects.library import effects_in

ENTRY_POINT = "bristle.kinds"


@dataclass(frozen=True)
class Kind:
    """A kind of data of one's own: ``problem`` reads a folder, and raises InputError where what is
    in it cannot be used."""

    name: str
    problem: Callable[[Path], Any]

    def load(self) -> Callable[[Path], Any]:
        """As an entry point's."""
        return self.problem


KINDS: dict[str, Kind | EntryPoint] = {
    name: EntryPoint(name, f"bristle.studies.loop.kinds.{name}.problem:read_problem", ENTRY_POINT)
    for name in ("drops", "tracks", "forces", "waves", "falls")
}


def load(path: Path, source: bytes) -> None:
    """Take in the effects and kinds of a Python file; ValueError where it has none, or one is
    refused."""
    module = outside.load(path, source)
    kinds = [each for each in vars(module).values() if isinstance(each, Kind)]
    if not kinds and not effects_in(module):
        raise ValueError(
            f"{path}: defines no subclass of Effect (solver.effects.base), and no Kind"
        )
    for kind in kinds:
        if not re.fullmatch(r"[a-z][a-z0-9_]*", kind.name):
            raise ValueError(f"{path}: a kind's name is of small letters, digits and _")
        if KINDS.setdefault(kind.name, kind) is not kind:
            raise ValueError(f"{path}: there is a kind {kind.name} of data already")


@lru_cache(maxsize=1)
def load_installed() -> None:
    """Take in the kinds of installed packages, after the program's own."""
    for point in entry_points(group=ENTRY_POINT):
        KINDS.setdefault(point.name, point)


@contextmanager
def forgotten_afterwards() -> Iterator[None]:
    """Effects and kinds that the block takes in are known inside it alone, but for those of
    installed packages."""
    before = set(KINDS)
    try:
        with outside.forgotten_afterwards():
            yield
    finally:
        for name in KINDS.keys() - before:
            if not isinstance(KINDS[name], EntryPoint):
                del KINDS[name]
