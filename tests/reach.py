"""Which test files can reach a planted fault: imports lead from them to it, nearest first."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).absolute().parents[1]
SOURCES = ("meshes", "solver", "studies")
FOLDERS = (ROOT, *(ROOT / "tests" / each for each in ("", "helpers", "reference")))


def in_order(path: str, tests: Iterable[str]) -> list[str]:
    """Those of the ``tests`` (names below tests/) that can reach a fault in a file of the program,
    by how many imports lead there."""
    steps = {name: distance(ROOT / "tests" / name, ROOT / path) for name in tests}
    return sorted((each for each in steps if steps[each]), key=lambda each: (steps[each], each))


def distance(start: Path, goal: Path) -> int:
    """Imports from one file to another; 0 where none lead there."""
    seen: set[Path] = set()
    front, steps = {start}, 0
    while front and goal not in front:
        seen |= front
        front = set().union(*(links()[path] for path in front)) - seen
        steps += 1
    return steps if front else 0


def importers(path: Path) -> set[Path]:
    """A file, and those that import it, directly or through others of these."""
    found, front = set(), {path}
    while front:
        found |= front
        front = {each for each, there in links().items() if front & there} - found
    return found


def files(*folders: str) -> list[Path]:
    """The Python files of these folders of the repository."""
    return [path for each in folders for path in sorted((ROOT / each).rglob("*.py"))]


@cache
def links() -> dict[Path, set[Path]]:
    """What each file of the program and its tests imports of these."""
    return {path: imports(path) for path in files(*SOURCES, "tests")}


def imports(path: Path) -> set[Path]:
    """Files of the repository that one imports, anywhere in it."""
    here = path.relative_to(ROOT).with_suffix("").parts
    wanted: list[tuple[str, ...]] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom):
            parts = tuple((node.module or "").split(".")) if node.module else ()
            stem = here[: len(here) - node.level] + parts if node.level else parts
            wanted += [stem, *((*stem, each.name) for each in node.names)]
        elif isinstance(node, ast.Import):
            wanted += [tuple(each.name.split(".")) for each in node.names]
    found = set()
    for parts in wanted:
        inside = parts[1:] if parts[:1] == ("bristle",) else parts
        # the package itself is the Python interface
        inside = inside or ("studies", "api")
        for folder in FOLDERS:
            found |= {folder.joinpath(*inside).with_suffix(".py")}
            found |= {folder.joinpath(*inside, "__init__.py")}
    return {each for each in found if each.is_file()}
